"""A small surface among pixels without points is rejected where it also fits worse than the large ones."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.filter.surfaces.brightness_edges import DividedSurfaces
from pipeline.filter.surfaces.surface_evidence import Figures
from pipeline.filter.surfaces.unconfirmed_surfaces import (
    ALL_OPEN,
    FAR_FROM_USUAL,
    LEAST_LOSS,
    LEAST_OPEN,
    MOSTLY_OPEN,
    TIMES_USUAL,
    TIMES_USUAL_PART,
    UNLIKE,
    reject_open,
    reject_parts,
    reject_unconfirmed,
    usual_rms,
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


@pytest.mark.parametrize(("rms", "loss"), [(1.01 * FAR_FROM_USUAL, 0.0), (0.0, 1.01 * UNLIKE)])
def test_where_the_border_is_mostly_open_one_of_both_is_enough(rms: float, loss: float) -> None:
    assert not remaining(rms=rms * RMS, loss=loss * LOSS, unknown=1.01 * MOSTLY_OPEN).any()
    assert remaining(rms=rms * RMS, loss=loss * LOSS, unknown=0.99 * MOSTLY_OPEN).all()
    assert remaining(rms=0.98 * rms * RMS, loss=0.98 * loss * LOSS, unknown=1.01 * MOSTLY_OPEN).all()


def parts_remaining(*, rms: float, open_share: float, large: int = LARGE) -> NDArray[np.uint8]:
    """Points of a bright patch on a wall of another brightness, and of a patch alone, both with these figures."""
    valid, brightness = np.zeros(SHAPE, np.uint8), np.full(SHAPE, 80, np.uint8)
    valid[WALL], valid[OTHER] = 1, 1
    brightness[5:25, 8:24] = 200
    whole, parts, link = Surfaces(SHAPE), DividedSurfaces(SHAPE), np.full(SHAPE, LEFT | UP, np.uint8)
    label = np.empty(SHAPE, np.uint16)
    whole.find(valid, link, 30)
    whole.paint(label)
    parts.find(valid, brightness, link, 30)
    patches = np.isin(np.arange(len(parts.surfaces.sizes)) + 1, [parts.label[15, 16], parts.label[25, 45]])
    assert patches.sum() == 2
    shares = np.where(patches, open_share, 0.0).astype(np.float32)
    none = np.zeros(len(patches), np.float32)
    continued = Continued(np.zeros(len(patches), np.int32), none, none, shares)
    reject_parts(parts, np.where(patches, rms, RMS), RMS, continued, label, whole.sizes, large, valid)
    assert valid[:, :4].all()
    return np.array([valid[15, 16], valid[25, 45]])


def test_a_part_of_a_large_surface_is_rejected_where_its_border_is_open() -> None:
    worse = 1.01 * TIMES_USUAL_PART * RMS
    assert parts_remaining(rms=worse, open_share=1.01 * LEAST_OPEN).tolist() == [0, 1]
    assert parts_remaining(rms=0.98 * worse, open_share=1.01 * LEAST_OPEN).all()
    assert parts_remaining(rms=worse, open_share=0.99 * LEAST_OPEN).all()
    assert parts_remaining(rms=0.0, open_share=1.01 * ALL_OPEN).tolist() == [0, 1]
    assert parts_remaining(rms=worse, open_share=1.0, large=60).all()


def test_a_part_of_a_small_surface_is_rejected_where_it_fits_far_worse() -> None:
    assert not parts_remaining(rms=1.01 * FAR_FROM_USUAL * RMS, open_share=1.01 * LEAST_OPEN).any()


def test_the_usual_rms_is_that_of_the_large_surfaces() -> None:
    sizes = np.array([100, 300, 50], np.int32)
    own = np.zeros(3)
    figures = Figures(sizes, own, np.array([0.1, 0.2, 0.9]), own, own, own, own, own)
    assert usual_rms(figures, sizes, 100) == pytest.approx((100 * 0.1 + 300 * 0.2) / 400)
    assert usual_rms(figures, sizes, 1000) == pytest.approx((100 * 0.1 + 300 * 0.2 + 50 * 0.9) / 450)
    assert usual_rms(figures._replace(rms=np.empty(0)), np.empty(0, np.int32), 100) == 0
