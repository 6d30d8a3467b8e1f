"""A small surface among pixels without points is rejected where it also fits worse than the large ones."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.filter.surfaces.surface_evidence import Figures
from pipeline.filter.surfaces.unconfirmed_surfaces import (
    LEAST_LOSS,
    LEAST_OPEN,
    TIMES_USUAL,
    reject_open,
    reject_unconfirmed,
)
from pipeline.fringe_order.margins.order_margins import Continued

SHAPE, LARGE = (40, 60), 500
WALL, PATCH, OTHER = np.s_[:, :30], np.s_[5:15, 35:45], np.s_[20:30, 35:55]
RMS, LOSS = 0.08, 0.3
"""Of the wall against the projector, radians; of the textures of matched pixels."""


def remaining(
    *, rms: float, loss: float, jumps: float = 0.0, unknown: float = 0.0, large: int = LARGE
) -> NDArray[np.uint8]:
    """Points of a wall, a patch with these figures and another small surface with those of the wall."""
    valid = np.zeros(SHAPE, np.uint8)
    for part in (WALL, PATCH, OTHER):
        valid[part] = 1
    surfaces = Surfaces(SHAPE)
    surfaces.find(valid, np.full(SHAPE, LEFT | UP, np.uint8), 30)
    assert surfaces.sizes.tolist() == [1200, 100, 200]
    n, patch = 3, np.array([False, True, False])
    own = np.full(n, 1.0)
    figures = Figures(
        surfaces.sizes, np.where(patch, loss, LOSS), np.where(patch, rms, RMS), own, own, own, own, np.zeros(n, bool)
    )
    shares = (np.where(patch, share, 1.0).astype(np.float32) for share in (0.0, jumps, unknown))
    reject_unconfirmed(figures, Continued(np.zeros(n, np.int32), *shares), LOSS, surfaces, large, valid)
    assert valid[WALL].all() and valid[OTHER].all() and valid.sum() in (1400, 1500)
    return valid[PATCH]


def test_a_surface_that_nothing_confirms_and_that_fits_worse_is_rejected() -> None:
    assert not remaining(rms=2 * RMS, loss=LOSS, unknown=0.6).any()
    assert not remaining(rms=2 * RMS, loss=LOSS, jumps=0.3, unknown=0.3).any()


@pytest.mark.parametrize("factor", [0.99, 1.01])
@pytest.mark.parametrize("which", ["open", "rms", "loss"])
def test_each_condition_is_necessary(which: str, factor: float) -> None:
    k = {name: factor if name == which else 1.01 for name in ("open", "rms", "loss")}
    points = remaining(
        rms=k["rms"] * TIMES_USUAL * RMS, loss=k["loss"] * LEAST_LOSS * LOSS, unknown=k["open"] * LEAST_OPEN
    )
    assert points.all() == (factor < 1) and points.any() == (factor < 1)


def test_large_surfaces_are_not_tested() -> None:
    assert remaining(rms=2 * RMS, loss=LOSS, unknown=1.0, large=100).all()


def test_without_large_surfaces_all_are_compared_with() -> None:
    """The patch is a fifteenth of all pixels."""
    usual = (1400 * RMS + 100 * 2 * RMS) / 1500
    assert TIMES_USUAL * usual < 2 * RMS
    assert not remaining(rms=2 * RMS, loss=LOSS, unknown=1.0, large=10**6).any()


def test_without_surfaces_nothing_happens() -> None:
    valid, surfaces = np.zeros(SHAPE, np.uint8), Surfaces(SHAPE)
    surfaces.find(valid, np.full(SHAPE, LEFT | UP, np.uint8), 30)
    none = np.empty(0)
    reject_unconfirmed(
        Figures(none, none, none, none, none, none, none, none), Continued.none(0), LOSS, surfaces, LARGE, valid
    )
    assert not valid.any()


@pytest.mark.parametrize(("jumps", "unknown", "large", "kept"), [
    (0.3, LEAST_OPEN - 0.29, LARGE, False), (0.3, LEAST_OPEN - 0.31, LARGE, True), (0.0, 1.0, 100, True),
])  # fmt: skip
def test_where_much_is_ambiguous_an_open_border_is_enough(jumps: float, unknown: float, large: int, kept: bool) -> None:
    """Of a patch of 100 points beside a wall."""
    valid = np.zeros(SHAPE, np.uint8)
    valid[WALL], valid[PATCH] = 1, 1
    surfaces = Surfaces(SHAPE)
    surfaces.find(valid, np.full(SHAPE, LEFT | UP, np.uint8), 30)
    shares = (np.array([1.0 if share else 0.0, share], np.float32) for share in (0.0, jumps, unknown))
    reject_open(Continued(np.zeros(2, np.int32), *shares), surfaces, large, valid)
    assert valid[WALL].all()
    assert valid[PATCH].all() == kept
    assert valid[PATCH].any() == kept
