"""Points on a step that windows have blurred are unknown; edges, slopes and bends of true surfaces stay."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.reconstruction.random_rigs import random_rig
from benchmarks.trust import errors_of
from pipeline.filter.blurred_steps import STEEP, least_step
from pipeline.filter.depth_bends import DepthSteps, bends_of, widen_at_bends
from pipeline.filter.mask_rejected import mask_unknown

SHAPE, FOCAL_PX, SIGMA = (40, 70), 2250.0, 0.03
DISTANCE = 900.0
SPACING = DISTANCE / FOCAL_PX
"""From one pixel to the next, mm."""
FIRST = 34
"""Column of the first pixel of a slope."""


def rejected(depth: Any, *, stride: int = 1, transposed: bool = False, order_mm: float = 60) -> Any:
    """Which points of a depth (H, W) become unknown; all their values do so together."""
    depth = np.ascontiguousarray(depth.T if transposed else depth)  # as clouds are: no other kernels are compiled
    xyz = np.repeat(depth[..., None], 3, axis=-1).astype(np.float32)
    sigma = np.where(np.isfinite(depth), np.float32(SIGMA), np.float32(np.nan)).astype(np.float32)
    order = np.where(np.isfinite(depth), 7, -1).astype(np.int16)
    shape = depth[::stride, ::stride].shape
    least = least_step(FOCAL_PX, stride)
    known, link = np.empty((2, *shape), np.uint8)
    per_order, steps = np.float32(order_mm / DISTANCE**2), DepthSteps((least, least), (least, least))
    widen_at_bends(stride, per_order, steps, xyz, sigma, bends_of(shape), known, link)
    mask_unknown(len(known), known, stride, xyz, sigma, order)
    lost = np.isfinite(depth) & ~np.isfinite(xyz[..., 2])
    assert (np.isnan(xyz).all(axis=-1) == np.isnan(sigma)).all()
    assert (np.isnan(sigma) == (order == -1)).all()
    return lost.T if transposed else lost


def step(height: float, width: int) -> Any:
    """Two levels with a slope of so many pixels between them, along the rows; a long one may be a surface."""
    across = np.clip((np.arange(SHAPE[1]) - FIRST + 1) / (width + 1), 0, 1)
    return np.broadcast_to(DISTANCE + height * across, SHAPE)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([-1, 1]), st.floats(1.2, 4.0), st.integers(1, 3), st.booleans(), st.floats(-0.2, 0.2))
def test_points_between_two_levels_are_unknown(
    sign: int, steep: float, width: int, transposed: bool, tilt: float
) -> None:
    height = sign * steep * STEEP * SPACING * (width + 1)
    depth = step(height, width) + SPACING * tilt * np.arange(SHAPE[1])
    lost = rejected(depth, transposed=transposed)
    expected = np.zeros(SHAPE, bool)
    expected[:, FIRST : FIRST + width] = True
    np.testing.assert_array_equal(lost, expected)


@pytest.mark.parametrize("height", [0.5, 5.0, 40.0])
def test_both_sides_of_a_sharp_edge_stay(height: float) -> None:
    assert not rejected(step(height, 0)).any()


def test_slopes_that_are_not_steep_or_long_stay() -> None:
    assert not rejected(step(0.9 * STEEP * SPACING * 3, 2)).any()
    lost = rejected(step(2 * STEEP * SPACING * 21, 20))
    assert not lost[:, FIRST + 6 : FIRST + 14].any()


def test_phases_of_two_orders_do_not_mix() -> None:
    """What lies between such surfaces is another one."""
    depth = step(2 * STEEP * SPACING * 3, 2)
    change = float(depth[0, FIRST + 1] - depth[0, FIRST - 1])
    assert rejected(depth, order_mm=2.2 * change).any()
    assert not rejected(depth, order_mm=1.8 * change).any()


def test_a_steep_surface_that_ends_there_stays() -> None:
    """A sphere becomes steep towards its end, and nothing is beyond it; a slope without an end is a surface."""
    depth = step(2 * STEEP * SPACING * 4, 3).copy()
    depth[:, FIRST + 3 :] = np.nan
    assert not rejected(depth).any()
    assert not rejected(DISTANCE + 2 * STEEP * SPACING * np.broadcast_to(np.arange(SHAPE[1]), SHAPE)).any()


def test_noise_is_no_step() -> None:
    rng = np.random.default_rng(3)
    assert not rejected(DISTANCE + 0.2 * SPACING * rng.standard_normal(SHAPE)).any()


def test_at_half_resolution_the_same_points_are_unknown() -> None:
    height = 2 * STEEP * SPACING * 6
    lost = rejected(step(height, 5), stride=2)
    expected = np.zeros(SHAPE, bool)
    expected[::2, FIRST : FIRST + 5 : 2] = True
    np.testing.assert_array_equal(lost, expected)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_slots_whose_edges_are_less_than_a_fringe_order_have_no_false_surface() -> None:
    """Rows of points at their edges were nine, and 0.46 % of the points were wrong."""
    found = errors_of(random_rig(58), 0)
    assert found.false_surfaces == 0
    assert found.wrong < 0.001
