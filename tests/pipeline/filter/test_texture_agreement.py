"""Agreement of textures at matched pixels: what it counts in, and what it does to sigma."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest

from pipeline.filter.texture_agreement import (
    DEVIATION_STEPS,
    NO_MATCH,
    Agreement,
    compare,
    scale_and_inside,
    scale_of,
)
from pipeline.match.match_result import PIXEL_STEPS, MatchResult

SHAPE = (90, 240)
SHIFT = 20


def _texture(rng: np.random.Generator, contrast: float = 0.4) -> Any:
    """Spots of a few pixels, (H, W + SHIFT), about 1."""
    coarse = rng.normal(0, contrast, (SHAPE[0] // 6 + 2, (SHAPE[1] + SHIFT) // 6 + 2))
    return np.exp(np.kron(coarse, np.ones((6, 6)))[: SHAPE[0], : SHAPE[1] + SHIFT])


def _images(rng: np.random.Generator, contrast: float = 0.4, gain: float = 1.0) -> tuple[Any, Any]:
    """Left and right image of one surface, the right one SHIFT pixels away and of another gain."""
    texture = _texture(rng, contrast)

    def seen(part: Any, factor: float) -> Any:
        noisy = [(factor * level * part + rng.normal(0, 1.0, part.shape)).clip(1, 254) for level in (70, 50)]
        mean, amplitude = (np.rint(plane).astype(np.uint8) for plane in noisy)
        return SimpleNamespace(mean=mean, modulation=amplitude)

    right = np.roll(texture, SHIFT, axis=1)
    return seen(texture[:, : SHAPE[1]], 1.0), seen(right, gain)


def _match(valid: Any | None = None) -> MatchResult:
    match = MatchResult.empty(SHAPE)
    i, j = np.indices(SHAPE)
    match.valid[:] = 1 if valid is None else valid
    match.right_u[:] = PIXEL_STEPS * (j + SHIFT) + PIXEL_STEPS // 2
    match.right_v[:] = PIXEL_STEPS * i + PIXEL_STEPS // 2
    return match


def _compared(match: MatchResult, left: Any, right: Any) -> tuple[Agreement, Any]:
    out = Agreement.empty(SHAPE)
    scale, inside = scale_and_inside(match, left, right, np.ones(SHAPE), (np.float32(0.0), np.float32(2.0)))
    compare(match, left, right, scale, inside, out)
    return out, scale


@pytest.mark.parametrize("gain", [1.0, 0.8, 1.25])
def test_matched_pixels_deviate_by_about_one_standard_deviation_whatever_the_gain(gain: float) -> None:
    left, right = _images(np.random.default_rng(1), gain=gain)
    found, _ = _compared(_match(), left, right)
    assert 0.3 * DEVIATION_STEPS < np.median(found.deviation) < 1.5 * DEVIATION_STEPS


def test_a_wrong_match_deviates_more_and_lets_a_phase_error_be_expected() -> None:
    left, right = _images(np.random.default_rng(2))
    match = _match()
    match.right_u[30:60, 100:150] += 17 * PIXEL_STEPS
    found, _ = _compared(match, left, right)
    wrong = np.s_[30:60, 100:150]
    assert np.median(found.deviation[wrong]) > 4 * np.median(found.deviation[:30])
    assert np.median(found.misfit[wrong]) > 10 * max(np.median(found.misfit[:30]), 1)


def test_the_scale_inside_the_limits_is_that_of_a_match_without_the_other_pixels() -> None:
    left, right = _images(np.random.default_rng(6))
    match, depth = _match(), np.full(SHAPE, 1000.0)
    match.right_u[:, 80:] += 17 * PIXEL_STEPS  # a wall behind the volume whose texture differs
    depth[:, 80:] = 2000.0
    limits = np.float32(900.0), np.float32(1100.0)
    scale, inside = scale_and_inside(match, left, right, depth, limits)
    assert scale == scale_of(match, left, right)
    assert inside.mean_sigma < 0.5 * scale.mean_sigma
    match.valid[:, 80:] = 0
    assert inside == scale_of(match, left, right)
    assert scale_and_inside(match, left, right, depth, limits) == (inside, inside)


def test_without_texture_unrelated_pixels_differ_no_more_than_matched_ones() -> None:
    rng = np.random.default_rng(3)
    textured, plain = (_compared(_match(), *_images(rng, contrast))[1] for contrast in (0.4, 0.0))
    assert textured.unrelated_loss > textured.matched_loss + 1
    assert abs(plain.unrelated_loss - plain.matched_loss) < 0.1


def test_pixels_without_a_match_are_marked_and_hold_no_sway() -> None:
    rng = np.random.default_rng(4)
    left, right = _images(rng)
    valid = (rng.random(SHAPE) < 0.8).astype(np.uint8)
    match = _match(valid)
    first, scale = _compared(match, left, right)
    match.right_u[valid == 0], match.right_v[valid == 0] = 65535, 65535
    second, again = _compared(match, left, right)
    assert scale == again and (first.deviation == second.deviation).all()
    assert ((first.deviation == NO_MATCH) == (valid == 0)).all()


@pytest.mark.threads
def test_the_comparison_does_not_depend_on_the_number_of_threads() -> None:
    left, right = _images(np.random.default_rng(5))
    most = numba.get_num_threads()
    results = []
    try:
        for threads in (1, most):
            numba.set_num_threads(threads)
            results.append(_compared(_match(), left, right)[0])
    finally:
        numba.set_num_threads(most)
    assert all((a == b).all() for a, b in zip(*results, strict=True))
