"""Links of lattice pixels: change of order and weight by the phase."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.fringe_order.phase_links import column_links

DOWN, STEP, ROWS, COLUMNS = 3, 2, 6, 5


def links(phase: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Change of order and weight of every lattice pixel and its upper neighbour, of an absolute phase."""
    wrapped = (phase - 2 * np.pi * np.rint(phase / (2 * np.pi))).astype(np.float32)
    count = np.full((ROWS, COLUMNS), 4, np.int32)
    jump, weight = np.empty((ROWS, COLUMNS), np.int32), np.empty((ROWS, COLUMNS), np.float32)
    valid = np.ones(wrapped.shape, np.bool_)
    column_links(ROWS, wrapped, valid, 0, DOWN, 0, STEP, np.float32(0), count, jump, weight)
    return jump[1:], weight[1:]


@settings(max_examples=30, deadline=None)
@given(st.floats(-2.5, 2.5), st.floats(-30, 30))
def test_the_order_changes_where_the_wrapped_phase_does(slope: float, start: float) -> None:
    phase = start + np.arange(DOWN * ROWS)[:, None] * slope + np.zeros(STEP * COLUMNS)
    turns = np.rint(phase / (2 * np.pi))[::DOWN, ::STEP]
    close = np.abs(np.abs(phase[::DOWN, ::STEP] / (2 * np.pi) % 1 - 0.5)) < 1e-3  # either turn is right
    jump, weight = links(phase)
    unclear = close[1:] | close[:-1]
    np.testing.assert_array_equal(jump[~unclear], np.diff(turns, axis=0)[~unclear])
    assert (weight > 0.99).all()


@pytest.mark.parametrize("step", [0.5, 1.0, 3.0])
def test_a_link_counts_less_the_more_the_phase_breaks(step: float) -> None:
    phase = np.zeros((DOWN * ROWS, STEP * COLUMNS))
    phase[2 * DOWN + 2 :] = step
    weight = links(phase)[1]
    assert (np.delete(weight, 2, axis=0) > 0.99).all()
    assert weight[2] == pytest.approx(np.exp(-min(4 * step * step, 8)), abs=1e-3)
