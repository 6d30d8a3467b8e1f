"""The period of the finest fringe is the only one that fits, or it is unknown."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.multi_frame.temporal_unwrapping import NONE, by_phase

TURN = 2 * np.pi


def _orders(absolute: Any, ratio: float, *, periods: float, deviation: float = 0.1) -> Any:
    """Orders of a row of absolute phases from a second fringe, whose phase is off by so many radians."""
    phase = np.stack([absolute, ratio * absolute + deviation])[:, None, :]
    phase = (phase - TURN * np.rint(phase / TURN)).astype(np.float32)
    row = phase.shape[1:]
    order, phasor = np.empty(row, np.int16), np.empty(row, np.int32)
    by_phase(
        1, phase, np.full(phase.shape, 50, np.float32), np.full(phase.shape, 1e-4, np.float32),
        np.zeros(row, np.float32), np.full(row, TURN * periods, np.float32), np.array([1, ratio], np.float32),
        np.array([1, 0], np.float32), 10.0, 0.5, np.zeros(row, np.float32), order, phasor,
    )  # fmt: skip
    assert ((order == NONE) == (phasor == 0)).all()
    return order[0]


ABSOLUTE = np.linspace(0.1, TURN * 2 - 0.1, 50)


def test_the_period_that_fits_is_found() -> None:
    np.testing.assert_array_equal(_orders(ABSOLUTE, 0.5, periods=2), np.rint(ABSOLUTE / TURN))


def test_of_two_periods_that_fit_alike_none_is_taken() -> None:
    """Half the frequency fits at every second period."""
    assert (_orders(ABSOLUTE, 0.5, periods=4) == NONE).all()


def test_a_period_that_fits_badly_is_not_taken() -> None:
    assert (_orders(ABSOLUTE, 0.5, periods=2, deviation=0.6) == NONE).all()
