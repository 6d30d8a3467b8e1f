"""Sharp bends of the depth raise the standard deviation, noise and smooth surfaces do not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.reconstruction.cases import random_case
from benchmarks.trust import errors_of
from pipeline.filter.blurred_steps import least_step
from pipeline.filter.depth_bends import (
    CLEAR,
    END_NOISE,
    FAR,
    NEAR,
    NOISE,
    ROWS,
    SHARE,
    SPREAD,
    DepthSteps,
    bends_of,
    widen_at_bends,
)

SHAPE, SIGMA = (3 * ROWS + 5, 90), 0.03
PER_ORDER = np.float32(30.0 / 900.0**2)
"""Fringe orders 30 mm apart at 900 mm."""
FOCAL_PX = 2250.0


def _cloud(depth: Any, sigma: float = SIGMA) -> tuple[Any, Any]:
    xyz = np.zeros((*depth.shape, 3), np.float32)
    xyz[..., 2] = depth
    return xyz, np.where(np.isfinite(depth), np.float32(sigma), np.float32(np.nan)).astype(np.float32)


def _widened(depth: Any, stride: int = 1, sigma: float = SIGMA) -> Any:
    xyz, sigmas = _cloud(depth, sigma)
    before = xyz.copy()
    shape = depth[::stride, ::stride].shape
    least = least_step(FOCAL_PX, stride)
    steps, planes = DepthSteps((least, least), (least, least)), np.empty((2, *shape), np.uint8)
    widen_at_bends(stride, PER_ORDER, steps, xyz, sigmas, bends_of(shape), *planes)
    np.testing.assert_array_equal(xyz, before)
    return sigmas


def _expected(depth: Any, stride: int = 1) -> Any:
    """The same for every point by itself, from the definition."""
    near, spread = NEAR // stride, SPREAD // stride
    z = np.pad(depth.astype(np.float64), 2 * FAR, constant_values=np.nan)

    def at(down: int, right: int) -> Any:
        return z[2 * FAR + down : len(z) - 2 * FAR + down, 2 * FAR + right : z.shape[1] - 2 * FAR + right]

    more = np.zeros(depth.shape)
    for down, right in ((0, 1), (1, 0)):
        bends = [at(-near * down, -near * right) - 2 * depth + at(near * down, near * right)]
        inner = [depth - 2 * at(s * FAR * down, s * FAR * right) + at(2 * s * FAR * down, 2 * s * FAR * right)
                 for s in (-1, 1)]  # fmt: skip
        both = np.isfinite(at(-FAR * down, -FAR * right) + at(FAR * down, FAR * right))
        bends.append(np.where(both, 0.0, np.where(np.isfinite(inner[0]), inner[0], inner[1])))
        for bend, noise in zip(bends, (NOISE, END_NOISE), strict=True):
            more += np.maximum(np.nan_to_num(bend) ** 2 - float(noise) * SIGMA**2, 0.0)
    most = more.copy()
    for step in range(1, spread + 1):
        most[step:] = np.maximum(most[step:], more[:-step])
        most[:-step] = np.maximum(most[:-step], more[step:])
        most[:, step:] = np.maximum(most[:, step:], more[:, :-step])
        most[:, :-step] = np.maximum(most[:, :-step], more[:, step:])
    more, most = float(SHARE) * more, float(SHARE) * most
    return np.sqrt(SIGMA**2 + np.where(most > float(CLEAR) * SIGMA**2, most, more))


def _scene() -> Any:
    rng = np.random.default_rng(1)
    i, j = np.indices(SHAPE)
    depth = 900 + 0.2 * j - 0.1 * i + SIGMA * rng.standard_normal(SHAPE)
    depth[40:, 30:] += 2.0
    depth[rng.random(SHAPE) < 0.2] = np.nan
    return depth.astype(np.float32)


def test_every_point_gets_the_variance_that_its_differences_define() -> None:
    depth = _scene()
    found, known = _widened(depth), np.isfinite(depth)
    assert np.isnan(found[~known]).all()
    np.testing.assert_allclose(found[known], _expected(depth)[known], rtol=2e-3)


def test_noise_and_curvature_leave_sigma_nearly_as_it_is() -> None:
    i, j = np.indices(SHAPE)
    white = np.random.default_rng(2).standard_normal((SHAPE[0] + 2, SHAPE[1] + 2))
    # As the phases have it that are fitted from windows of 3 x 3 pixels.
    rows = white[:-2] + 2 * white[1:-1] + white[2:]
    noise = SIGMA / 6 * (rows[:, :-2] + 2 * rows[:, 1:-1] + rows[:, 2:])
    ball = 900 - np.sqrt(50.0**2 - (0.4 * (j - 45)) ** 2 - (0.4 * (i - 50)) ** 2)
    for depth in (900 + 0.3 * j + noise, ball + noise):
        found = _widened(depth.astype(np.float32))
        assert (found >= np.float32(SIGMA)).all()
        assert np.sqrt(np.mean(found**2)) < 1.1 * SIGMA
    np.testing.assert_allclose(_widened(ball.astype(np.float32)), SIGMA, rtol=1e-3)
    found = _widened((900 + SIGMA * white[1:-1, 1:-1]).astype(np.float32))
    assert np.sqrt(np.mean(found**2)) < 1.4 * SIGMA


@pytest.mark.parametrize("step", [1.5, 2.0, 5.0])
def test_points_between_two_depths_get_a_sigma_of_their_error(step: float) -> None:
    truth, depth = _smoothed_step(step, (1, 2, 1))
    found, error = _widened(depth), np.abs(depth - truth)
    mixed = error > 1e-3
    assert mixed.any()
    assert (0.5 * error[mixed] < found[mixed]).all() and (found[mixed] < 2.2 * error.max() + SIGMA).all()
    i = np.indices(SHAPE)[0]
    np.testing.assert_allclose(found[(i < 44) | (i > 56)], SIGMA, rtol=1e-5)


@pytest.mark.parametrize("inclined", [0.0, 0.6, 1.2])
def test_points_on_the_slope_that_a_wide_window_makes_of_a_step_have_no_sigma_of_noise(inclined: float) -> None:
    """Also where one side is inclined, so that the slope is hardly steeper than the surface."""
    truth, depth = _smoothed_step(5.0, (1, 2, 3, 2, 1), inclined)
    found, error = _widened(depth), np.abs(depth - truth)
    mixed = error > 1e-3
    assert np.sqrt(np.mean((error[mixed] / SIGMA) ** 2)) > 30
    assert np.sqrt(np.mean((error[mixed] / found[mixed]) ** 2)) < 2.5
    assert (found[mixed] < 1.5 * error.max()).all()


def _smoothed_step(step: float, weights: tuple[int, ...], inclined: float = 0.0) -> tuple[Any, Any]:
    """Depths with a step between two rows, inclined from there on, and what a window of so many rows makes of it."""
    reach = len(weights) // 2
    i = np.indices(SHAPE)[0]
    truth = np.where(i < 50, 900.0, 900.0 + step + inclined * (i - 50))
    padded = np.pad(truth, ((reach, reach), (0, 0)), mode="edge")
    mean = sum(w * padded[k : k + len(truth)] for k, w in enumerate(weights)) / sum(weights)
    return truth, mean.astype(np.float32)


def test_the_end_of_a_surface_that_drifts_off_is_noticed() -> None:
    """Beside the end of what a camera sees, the error grows over some pixels; both neighbours err alike."""
    depth = np.full(SHAPE, 900.0)
    depth[:, 60:] = np.nan
    error = np.array([0.1, 0.4, 0.7, 0.7])
    depth[:, 56:60] -= error
    found = _widened(depth.astype(np.float32))
    assert (found[:, 57:60] > 0.4 * error[1:]).all()
    np.testing.assert_allclose(found[:, :52], SIGMA, rtol=1e-5)


def test_points_of_another_surface_are_no_neighbours() -> None:
    depth = np.full(SHAPE, 900.0)
    depth[:, 40:] += 20.0  # more than half a fringe order
    np.testing.assert_array_equal(_widened(depth.astype(np.float32)), np.float32(SIGMA))
    depth[:, 40:] -= 10.0
    assert (_widened(depth.astype(np.float32))[:, 39:41] > 3.0).all()


def test_of_a_grid_with_a_stride_only_measured_pixels_count() -> None:
    depth = _scene()
    sparse = np.full((2 * SHAPE[0] - 1, 2 * SHAPE[1]), np.nan, np.float32)
    sparse[::2, ::2] = depth
    found = _widened(sparse, stride=2)
    known = np.isfinite(depth)
    np.testing.assert_allclose(found[::2, ::2][known], _expected(depth, stride=2)[known], rtol=2e-3)
    assert np.isnan(found[1::2]).all() and np.isnan(found[:, 1::2]).all()


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("number", [10, 22])
def test_sigma_beside_steps_to_an_inclined_surface_is_that_of_the_error(number: int) -> None:
    """Full size; error / sigma was 2.2 at edges."""
    edge = errors_of(random_case(number), 0).rings["edge"]
    assert 0.8 < edge.error_to_sigma < 1.5
