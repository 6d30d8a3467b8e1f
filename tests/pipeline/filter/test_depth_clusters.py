"""Clusters of too few points are unknown; what hangs together by depth stays, on slopes up to a limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.reconstruction.random_rigs import random_rig
from benchmarks.trust import errors_of
from pipeline.filter.depth_bends import DepthSteps, bends_of, widen_at_bends
from pipeline.filter.depth_clusters import LARGEST_TANGENT, Clusters, largest_step
from pipeline.filter.surfaces.small_surfaces import LEAST_WIDTH, RELIABLE
from sim.evaluate.point_errors import surface_labels

SHAPE, FOCAL_PX, DISTANCE, SMALLEST = (60, 80), 2250.0, 900.0, 20
SPACING = DISTANCE / FOCAL_PX
"""From one pixel to the next, mm."""
NEVER = np.float32(1e6)


def rejected(depth: Any, *, stride: int = 1, on_step: Any = None, smallest: int = SMALLEST) -> Any:
    """Which points of a depth (H, W) are rejected, by pixels that are ``stride`` apart."""
    xyz = np.repeat(depth[..., None], 3, axis=-1).astype(np.float32)
    sigma = np.full(depth.shape, np.float32(0.03))
    shape, most = depth[::stride, ::stride].shape, largest_step(FOCAL_PX, stride)
    clusters, measured = Clusters(shape, smallest, stride), np.isfinite(depth[::stride, ::stride])
    steps = DepthSteps((NEVER, NEVER), (most, most))
    widen_at_bends(stride, np.float32(1e-4), steps, xyz, sigma, bends_of(shape), clusters.known, clusters.link)
    np.testing.assert_array_equal(clusters.known, measured)
    if on_step is not None:
        clusters.known[on_step] = 0
    clusters.reject_small()
    return measured & (clusters.known == 0)


def block(depth: Any, height: int, width: int, step: float) -> Any:
    """A block in the middle of a plane, so many mm before it."""
    out = depth.copy()
    out[20 : 20 + height, 30 : 30 + width] -= step
    return out


PLANE = np.full(SHAPE, DISTANCE)


@pytest.mark.parametrize("stride", [1, 2])
def test_a_block_of_too_few_points_is_rejected_where_the_depth_steps(stride: int) -> None:
    limit = LARGEST_TANGENT * stride * SPACING
    small, large = (block(PLANE, side * stride, side * stride, 1.1 * limit) for side in (4, 5))
    np.testing.assert_array_equal(rejected(small, stride=stride), (small < DISTANCE)[::stride, ::stride])
    assert not rejected(large, stride=stride).any()
    assert not rejected(block(PLANE, 4 * stride, 4 * stride, 0.9 * limit), stride=stride).any()


def test_points_on_steps_connect_nothing() -> None:
    """A small part beside a plane, with a row of pixels on the slope between: rejected without that row."""
    depth = np.full(SHAPE, np.nan)
    depth[:, 40:], depth[20:24, 30:34] = DISTANCE, DISTANCE - 8 * SPACING
    depth[20:24, 34:40] = DISTANCE - 4 * SPACING
    assert not rejected(depth).any()
    slope = np.zeros(SHAPE, bool)
    slope[:, 34:40] = np.isfinite(depth[:, 34:40])
    np.testing.assert_array_equal(rejected(depth, on_step=slope), slope | (depth < DISTANCE - 6 * SPACING))


def test_narrow_clusters_are_rejected_unless_they_are_large() -> None:
    width = int(LEAST_WIDTH) - 1
    strip = np.full(SHAPE, np.nan)
    strip[5:55, 30 : 30 + width] = DISTANCE
    assert 50 * width < RELIABLE * SMALLEST
    np.testing.assert_array_equal(rejected(strip), np.isfinite(strip))
    assert not rejected(strip, smallest=50 * width // RELIABLE).any()
    strip[5:55, 30 : 30 + width + 2] = DISTANCE
    assert not rejected(strip).any()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 0.9))
def test_what_remains_are_the_clusters_of_the_definition(seed: int, share: float) -> None:
    """Of random points at two depths, against another program that labels connected pixels."""
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random(SHAPE) < share, DISTANCE, np.nan) - 50.0 * (rng.random(SHAPE) < 0.3)
    labels = surface_labels(depth.astype(np.float32))
    rows, columns = np.indices(SHAPE)
    expected = np.zeros(SHAPE, bool)
    for k in range(1, labels.max() + 1):
        here = labels == k
        length = max(np.ptp(rows[here]), np.ptp(columns[here])) + 1
        small = here.sum() < RELIABLE * SMALLEST
        expected |= here & (here.sum() < SMALLEST or (small and here.sum() < LEAST_WIDTH * length))
    np.testing.assert_array_equal(rejected(depth), expected)


def test_an_image_without_points_passes() -> None:
    assert not rejected(np.full(SHAPE, np.nan)).any()


@pytest.mark.long
@pytest.mark.timeout(300)
def test_remains_of_a_false_surface_beside_a_blurred_step_are_none() -> None:
    """Of slots: 75 points had the depth of the wall behind."""
    assert errors_of(random_rig(12), 0).false_surfaces == 0
