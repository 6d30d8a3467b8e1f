"""Standard deviation of the points beyond the images' noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.common.parallel_for import blocks
from pipeline.decode.pixel_descriptor import periodic
from pipeline.filter.sigma_terms import BLUR, LAG, MOSAIC, ROWS, SATURATED, THREE_CHIPS, Shares, shares_of, widen_sigma
from pipeline.match.match_result import PIXEL_STEPS, RESIDUAL_STEP, TURN_STEPS, MatchResult
from pipeline.reconstruct.camera_response import scatter_of

SHAPE = (150, 200)
SLOPES = (0.6, 0.0)


@pytest.mark.parametrize("stride", [1, 3])
def test_sigma_is_never_less_than_noise_and_grows_with_misfit_and_bias(stride: int) -> None:
    rng = np.random.default_rng(6)
    shape = (20, 31)
    misfit = rng.integers(0, 200, shape).astype(np.uint8) * (rng.random(shape) < 0.5).astype(np.uint8)
    match = MatchResult.empty(shape)
    match.residual_normalised[:], match.residual[:] = rng.integers(-90, 90, (2, *shape))
    variance = np.full(shape, 1e-4, np.float32)
    noise = rng.uniform(0.01, 0.1, (stride * 20, stride * 31)).astype(np.float32)
    sigma = noise.copy()
    widen_sigma(blocks(len(misfit), ROWS), misfit, match, variance, Shares(0.01, 0.2, 3e-5), SLOPES, stride, sigma)
    part = np.s_[::stride, ::stride]
    assert (sigma >= noise).all()
    bias = (match.residual_normalised.astype(float) - match.residual) * RESIDUAL_STEP
    more = 0.01 * bias**2 + 0.2 * (misfit / 256.0) ** 2 + 3e-5
    assert np.allclose(sigma[part], noise[part] * np.sqrt(1 + more / (2 * variance)), rtol=1e-4)
    others = np.ones(sigma.shape, bool)
    others[part] = False
    assert (sigma[others] == noise[others]).all()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("stride", [1, 2])
def test_bias_adds_as_far_as_the_other_image_keeps_less_modulation(axis: int, sign: int, stride: int) -> None:
    """Against the formula, on a surface that the right image shows compressed, and the same for all directions."""
    shape, left, bias = (40, 60), 0.5, 0.2
    at = np.arange(60)[None] + np.zeros(shape) if axis == 0 else np.arange(40)[:, None] + np.zeros(shape)
    variance = np.full(shape, 1e-4, np.float32)

    def widened(compression: float, valid: int = 1) -> Any:
        match = MatchResult.empty(shape)
        match.valid[:], match.residual[:], match.residual_normalised[:] = valid, 0, round(bias / RESIDUAL_STEP)
        match.absolute_phase[:] = np.round(sign * left * stride * at * TURN_STEPS / (2 * np.pi))
        (match.right_u if axis == 0 else match.right_v)[:] = np.round(PIXEL_STEPS * (9 + stride * compression * at))
        sigma = np.ones((stride * 40, stride * 60), np.float32)
        slopes = (sign * 0.6 * stride, 0.0) if axis == 0 else (0.0, sign * 0.6 * stride)
        misfit = np.zeros(shape, np.uint8)
        widen_sigma(blocks(len(misfit), ROWS), misfit, match, variance, Shares(0.0, 0.0), slopes, stride, sigma)
        inner = sigma[::stride, ::stride][LAG:-LAG, LAG:-LAG]
        assert (sigma >= 1).all()
        return inner

    for compression in (0.4, 0.6, 0.8, 1.0, 1.3):
        kept = np.exp(-BLUR * ((left / compression) ** 2 - left**2))
        expected = np.sqrt(1 + 0.5 * (bias * (1 - kept)) ** 2 / 1e-4)
        assert np.median(widened(compression)) == pytest.approx(expected, rel=0.05)
    assert (widened(0.5, valid=0) == 1).all()


def _match(normalised: Any, valid: Any = None) -> MatchResult:
    match = MatchResult.empty(SHAPE)
    match.valid[:] = 1 if valid is None else valid
    match.residual_normalised[:] = normalised
    return match


def _shares(
    match: MatchResult, *, noise: float = 1e-5, mosaic: bool = False, saturated: float = 0.0,
    depth: Any = 1.0, slopes: tuple[float, float] = SLOPES, corrected: float = 0.0,
) -> Shares:  # fmt: skip
    depth = np.broadcast_to(np.float32(depth), SHAPE)
    return shares_of(
        match, np.full(SHAPE, noise, np.float32), depth, (0.5, 2.0), slopes=slopes, mosaic=mosaic, saturated=saturated,
        corrected=corrected,
    )  # fmt: skip


def test_phases_that_follow_the_projector_add_nothing() -> None:
    assert _shares(_match(0)).variance == 0
    assert _shares(_match(120)).variance == 0  # an offset is the drift's business
    noise = np.random.default_rng(1).normal(0, 0.04 / RESIDUAL_STEP, SHAPE)
    assert _shares(_match(noise), noise=1e-3).variance == 0


def test_an_error_that_repeats_with_the_fringes_adds_in_proportion_to_its_square() -> None:
    wave = np.sin(2 * SLOPES[0] * np.arange(SHAPE[1])) / RESIDUAL_STEP
    odd = np.sin(SLOPES[0] * np.arange(SHAPE[1]))[None] / RESIDUAL_STEP + np.zeros(SHAPE)
    small, large = (_shares(_match(size * odd)).variance for size in (0.2, 0.4))
    assert 0 < small < large and 3 < large / small < 5
    unknown = np.zeros(SHAPE, np.uint8)
    assert _shares(_match(wave, unknown)).variance == 0


def test_a_periodic_error_that_is_corrected_still_counts_as_its_scatter() -> None:
    error = np.array([0.1, 0.05, 0.2, 0.1, 0.0, 0.15])
    turn = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    apart = (periodic(turn + np.pi) - periodic(turn)) @ error
    assert scatter_of(error) == pytest.approx(np.mean(apart**2))
    wave = periodic(SLOPES[0] * np.arange(SHAPE[1])) @ error
    uncorrected = _shares(_match(np.tile(wave, (SHAPE[0], 1)) / RESIDUAL_STEP)).variance
    assert _shares(_match(0), corrected=scatter_of(error)).variance == pytest.approx(uncorrected, rel=0.5)


def test_mosaics_and_saturated_images_err_more() -> None:
    assert _shares(_match(0), mosaic=True) == MOSAIC
    assert _shares(_match(0)) == THREE_CHIPS
    bias = [_shares(_match(0), saturated=share).bias for share in (0.0, 0.01, 0.05, 0.5)]
    assert bias == sorted(bias) and bias[2] == bias[3] == pytest.approx(SATURATED * THREE_CHIPS.bias)


def test_surfaces_outside_of_the_volume_and_the_textures_of_wide_fringes_add_nothing() -> None:
    odd = 0.4 * np.sin(SLOPES[0] * np.arange(SHAPE[1]))[None] / RESIDUAL_STEP + np.zeros(SHAPE)
    behind = np.where(np.arange(SHAPE[0])[:, None] < SHAPE[0] // 2, 1.0, 3.0)
    half = np.where(behind > 2, odd, 0)
    assert _shares(_match(odd)).variance > 0
    assert _shares(_match(half), depth=behind).variance == 0
    wide = SLOPES[0] / 6
    slow = 0.1 * np.sin(wide * np.arange(SHAPE[1]))[None] / RESIDUAL_STEP + np.zeros(SHAPE)
    assert _shares(_match(slow), slopes=(wide, 0.0)).variance == 0
