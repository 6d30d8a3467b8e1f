"""Standard deviation of the points beyond the images' noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.filter.sigma_terms import MOSAIC, SATURATED, THREE_CHIPS, Shares, shares_of, widen_sigma
from pipeline.match.match_result import RESIDUAL_STEP, MatchResult

SHAPE = (150, 200)
SLOPES = (0.6, 0.0)


@pytest.mark.parametrize("stride", [1, 3])
def test_sigma_is_never_less_than_noise_and_grows_with_misfit_and_bias(stride: int) -> None:
    rng = np.random.default_rng(6)
    shape = (20, 31)
    misfit = rng.integers(0, 200, shape).astype(np.uint8) * (rng.random(shape) < 0.5).astype(np.uint8)
    normalised, residual = rng.integers(-90, 90, (2, *shape)).astype(np.int16)
    variance = np.full(shape, 1e-4, np.float32)
    noise = rng.uniform(0.01, 0.1, (stride * 20, stride * 31)).astype(np.float32)
    sigma = noise.copy()
    widen_sigma(len(misfit), misfit, normalised, residual, variance, Shares(0.01, 0.2, 3e-5), stride, sigma)
    part = np.s_[::stride, ::stride]
    assert (sigma >= noise).all()
    bias = (normalised.astype(float) - residual) * RESIDUAL_STEP
    more = 0.01 * bias**2 + 0.2 * (misfit / 256.0) ** 2 + 3e-5
    assert np.allclose(sigma[part], noise[part] * np.sqrt(1 + more / (2 * variance)), rtol=1e-4)
    others = np.ones(sigma.shape, bool)
    others[part] = False
    assert (sigma[others] == noise[others]).all()


def _match(normalised: Any, valid: Any = None) -> MatchResult:
    match = MatchResult.empty(SHAPE)
    match.valid[:] = 1 if valid is None else valid
    match.residual_normalised[:] = normalised
    return match


def _shares(match: MatchResult, *, noise: float = 1e-5, mosaic: bool = False, saturated: float = 0.0) -> Shares:
    return shares_of(
        match, np.full(SHAPE, noise, np.float32), slopes=SLOPES, mosaic=mosaic, saturated=saturated
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


def test_mosaics_and_saturated_images_err_more() -> None:
    assert _shares(_match(0), mosaic=True) == MOSAIC
    assert _shares(_match(0)) == THREE_CHIPS
    bias = [_shares(_match(0), saturated=share).bias for share in (0.0, 0.01, 0.05, 0.5)]
    assert bias == sorted(bias) and bias[2] == bias[3] == pytest.approx(SATURATED * THREE_CHIPS.bias)
