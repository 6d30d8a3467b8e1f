"""Orders that continue what is beside a surface: found where phase and brightness go on across its border."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.decode.decoder import PhaseMap
from pipeline.filter.surfaces.continued_orders import LEAST_PLACES, LEAST_SHARE, continued_orders
from pipeline.fringe_order.margins.order_margins import Continued
from pipeline.match.match_result import TURN_STEPS, MatchResult

SHAPE = (60, 90)
PATCH = np.s_[20:40, 30:60]
STEP = 21.0
"""Change of the phase by a pixel along a row, in TURN_STEPS of a turn."""


def found(
    turns: float,
    *,
    brightness: int = 100,
    large: int = 2000,
    unknown: NDArray[np.bool_] | None = None,
    without_order: NDArray[np.bool_] | None = None,
    across: float = 3.0,
    transposed: bool = False,
) -> Continued:
    """Of a wall and a patch of it, whose absolute phase is so many turns behind, and which is so bright; the wall 100.

    Args:
        unknown: pixels without a phase; without_order: those with one, but without a match.
        across: change of the phase from row to row, steps.
    """
    y, x = np.indices(SHAPE)
    patch = np.zeros(SHAPE, bool)
    patch[PATCH] = True
    phase = np.rint(9000 + STEP * x + across * y - np.where(patch, turns * TURN_STEPS, 0)).astype(np.int16)
    nothing = np.zeros(SHAPE, bool)
    known = ~(nothing if unknown is None else unknown)
    matched = (known & ~(nothing if without_order is None else without_order)).astype(np.uint8)
    wrapped = np.angle(np.exp(1j * phase * 2 * np.pi / TURN_STEPS)).astype(np.float32)
    mean = np.where(patch, brightness, 100).astype(np.uint8)
    planes = patch, phase, matched, mean, wrapped, known
    every = (np.ascontiguousarray(p.T) for p in planes) if transposed else planes
    patch, phase, matched, mean, wrapped, known = every
    blank = np.zeros(patch.shape, np.int32)
    left = PhaseMap(blank, blank, mean, wrapped, 0.0, wrapped, mean, known, mean)
    match = MatchResult.empty(patch.shape)
    match.absolute_phase[:], match.valid[:] = phase, matched
    link = np.full(patch.shape, LEFT | UP, np.uint8)
    link[:, 1:][patch[:, 1:] != patch[:, :-1]] &= ~LEFT
    link[1:][patch[1:] != patch[:-1]] &= ~UP
    surfaces, label = Surfaces(patch.shape), np.empty(patch.shape, np.uint16)
    surfaces.find(matched, link, 30)
    surfaces.paint(label)
    continued = continued_orders(match, left, label, surfaces, large, match.valid)
    own = np.unique(label[patch & (matched > 0)]).astype(int) - 1
    others = np.setdiff1d(np.arange(len(surfaces.sizes)), own)
    assert not (known & (matched > 0)).all() or not continued.change[others].any()  # the wall is large
    return Continued(*(values[own] for values in continued))


def of_patch(continued: Continued) -> tuple[int, float]:
    (change,), (share,), (jumps,), (unknown,) = (values.tolist() for values in continued)
    assert share <= jumps <= 1 - unknown
    return change, share


@settings(max_examples=25, deadline=None)
@given(st.integers(-20, 20).filter(bool), st.floats(-0.06, 0.06), st.booleans(), st.floats(-9, 9))
def test_a_patch_of_a_wall_would_continue_it_by_the_turns_that_it_lacks(
    turns: int, off: float, transposed: bool, across: float
) -> None:
    assert of_patch(found(turns + off, transposed=transposed, across=across)) == (turns, 1.0)


@pytest.mark.parametrize("off", [-0.4, -0.1, 0.1, 0.25])
def test_at_an_edge_the_phase_does_not_continue(off: float) -> None:
    assert of_patch(found(3 + off)) == (0, 0.0)


@pytest.mark.parametrize(("brightness", "change"), [(80, 0), (90, 3), (110, 3), (125, 0)])
def test_nor_where_the_brightness_changes(brightness: int, change: int) -> None:
    assert of_patch(found(3, brightness=brightness))[0] == change


def test_the_same_order_and_large_surfaces_are_no_jump() -> None:
    assert of_patch(found(0)) == (0, 0.0)
    assert of_patch(found(3, large=500)) == (0, 0.0)


def without(*parts: tuple[slice, slice]) -> NDArray[np.bool_]:
    """Pixels of these parts of the image."""
    unknown = np.zeros(SHAPE, bool)
    for part in parts:
        unknown[part] = True
    return unknown


def test_the_share_counts_all_places_along_the_border() -> None:
    height, width = (part.stop - part.start for part in PATCH)
    every = 2 * (height + width)
    for part, side in ((np.s_[:, :30], height), (np.s_[:20, :], width)):
        change, share = of_patch(found(3, unknown=without(part)))
        assert (change, share) == (3, pytest.approx(1 - side / every, abs=0.02))


@pytest.mark.parametrize(("left", "right", "change"), [(0, 0, 0), (17, 0, 0), (8, 14, 0), (10, 17, 3), (20, 20, 3)])
def test_a_small_share_is_an_accident(left: int, right: int, change: int) -> None:
    """Known beside the patch are as many rows on either side."""
    known = without(np.s_[20 : 20 + left, :30], np.s_[20 : 20 + right, 60:], PATCH)
    assert of_patch(found(3, unknown=~known))[0] == change
    height, width = (part.stop - part.start for part in PATCH)
    assert (left + right >= max(LEAST_SHARE * 2 * (height + width), LEAST_PLACES)) == (change != 0)


@pytest.mark.parametrize(("off", "brightness", "unknown"), [(0.0, 100, 0.3), (0.2, 100, 0.0), (0.0, 130, 0.0)])
def test_pixels_without_an_order_are_counted_where_phase_and_brightness_continue(
    off: float, brightness: int, unknown: float
) -> None:
    """Above the patch there are phases, but no orders."""
    above = without(np.s_[:20, :])
    continued = found(3 + off, brightness=brightness, without_order=above)
    of_patch(continued)
    assert continued.unknown == pytest.approx(unknown, abs=0.02)
    assert not found(3 + off, brightness=brightness, unknown=above).unknown.any()
