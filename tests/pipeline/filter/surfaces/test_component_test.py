"""The test of connected surfaces by texture and by the projector's phase."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.common.connected_components import Surfaces
from pipeline.filter.point_filter import phase_weight
from pipeline.filter.surfaces import surface_links
from pipeline.filter.surfaces.component_test import LEAST_RATIO, component_test
from pipeline.filter.surfaces.surface_evidence import Figures, log_likelihood_ratio, ratio_of_inside
from pipeline.filter.texture_agreement import DEVIATION_STEPS, Scale
from pipeline.match.match_result import RESIDUAL_STEP, MatchResult
from pipeline.pattern.color_fringe import modulated_profile

TEXTURED = Scale(0.0, 0.01, 0.0, 0.02, 0.3, 2.4)
PLAIN = TEXTURED._replace(unrelated_loss=0.3)
NONE = np.nan
"""No inside, or too narrow to compare its texture with itself."""


def _ratio(
    pixels: float, loss: Any, rms: Any, scale: Scale, weight: float = 1.0, *, inside: Any = NONE, own: Any = NONE
) -> Any:
    return log_likelihood_ratio(_figures(pixels, loss, rms, inside, own), scale, weight)


def _figures(pixels: Any, loss: Any, rms: Any, rms_inside: Any, own: Any, inside: Any = 0, loss_inside: Any = 0) -> Any:
    return Figures(pixels, loss, rms, np.asarray(rms_inside), inside, loss_inside, np.asarray(own), np.asarray(False))


def test_the_evidence_for_a_surface_falls_with_its_loss_and_with_its_phase_residual() -> None:
    loss, rms = np.linspace(0, 4, 30), np.linspace(0.01, 0.5, 30)
    for own in (NONE, 0.3, 1.5):
        assert (np.diff(_ratio(100.0, loss, 0.05, TEXTURED, own=own)) <= 0).all()
        assert (np.diff(_ratio(100.0, 0.5, rms, TEXTURED, own=own)) <= 0).all()
        assert (np.diff(_ratio(100.0, 0.5, 0.05, TEXTURED, inside=rms, own=own)) <= 0).all()


def test_the_evidence_for_a_surface_rises_with_what_its_own_texture_distinguishes() -> None:
    ratios = _ratio(200.0, 0.35, 0.05, TEXTURED, own=np.linspace(0, 4, 30))
    assert (np.diff(ratios) >= 0).all()
    assert ratios[0] == pytest.approx(1.0)
    assert ratios[-1] == pytest.approx(6.0)


def test_texture_counts_for_nothing_where_there_is_none() -> None:
    few, many = (_ratio(500.0, loss, 0.05, PLAIN) for loss in (0.1, 3.0))
    assert few == many == pytest.approx(0.0)


def test_the_phase_counts_for_nothing_where_the_layout_is_blind() -> None:
    equal, modulated = (np.float32(2 * np.pi * np.arange(1280) / 13.3), np.float32(modulated_profile(1280, 96.0)))
    assert phase_weight(2.0, equal, linear=True) == 0.0
    assert phase_weight(2.0, equal, linear=False) == pytest.approx(0.0, abs=1e-3)
    for ratio in (1 / 0.45, 1 / 0.382, 1 / 0.6):
        assert phase_weight(ratio, equal, linear=True) == phase_weight(ratio, modulated, linear=False) == 1.0
        assert phase_weight(ratio, equal, linear=False) == 1.0, "both formulas agree"
    assert 0.2 < phase_weight(2.0, modulated, linear=False) < 0.5 < phase_weight(3.0, modulated, linear=False) < 1
    assert phase_weight(5000.0, modulated, linear=False) == 0.0, "nothing is known of orders beyond the pattern"
    low, high = (_ratio(500.0, 0.3, rms, TEXTURED, 0.0) for rms in (0.01, 0.4))
    assert low == high


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0])
def test_a_texture_inside_is_evidence_as_far_as_it_agrees_and_is_the_surfaces_own(weight: float) -> None:
    """The loss of the whole surface is that of a false one."""
    losses = np.linspace(0, 3, 31)

    def ratio(loss: Any, *, inside: Any = 400, own: Any = NONE, rms: Any = 0.05) -> Any:
        return ratio_of_inside(_figures(900.0, 2.4, 0.1, rms, own, inside, loss), TEXTURED, weight)

    of_loss = ratio(losses)
    assert (np.diff(of_loss[np.isfinite(of_loss)]) <= 0).all()
    assert np.isfinite(of_loss[0]) and np.isneginf(of_loss[-1])
    assert np.isneginf(ratio(0.2, inside=np.array([10, 99]))).all() and np.isneginf(ratio(0.2, rms=NONE))
    assert np.isneginf(ratio(0.2, own=0.3)), "a uniform texture agrees everywhere"
    assert np.isfinite(ratio(0.2, own=2.0))
    assert weight < 1 or ratio(0.2, rms=0.3) < LEAST_RATIO, "the projector's phase counts more"


def test_of_a_surface_whose_border_is_foreign_the_inside_stays() -> None:
    """The rims of the second: where windows see the texture of another surface, or pixels belong to it."""
    inside = np.abs(np.arange(90) % 30 - 14.5) < 9
    kept = _tested([0.8, 0.8, 0.8], [0.03, 0.06, 0.03], TEXTURED, rim=[0.8, 9.0, 0.8], columns=True)
    assert (kept == np.where((np.arange(90) // 30 == 1) & ~inside, 0, 1)).all()
    uniform = np.full((30, 90), 80, np.uint8)
    kept = _tested([0.8, 0.8, 0.8], [0.03, 0.06, 0.03], TEXTURED, rim=[0.8, 9.0, 0.8], mean=uniform)
    assert (kept == [1, 0, 1]).all()
    kept = _tested([0.8, 9.0, 0.8], [0.03, 0.06, 0.03], TEXTURED, rim=[0.8, 0.8, 0.8])
    assert (kept == [1, 0, 1]).all(), "only a border that agrees"


def _tested(
    deviation: Any, residual: Any, scale: Scale, *, mean: Any = None, weight: float = 1.0, border: float = 0.0,
    rim: Any = None, columns: bool = False,
) -> Any:  # fmt: skip
    """What remains of three surfaces of 30 x 30 pixels side by side, of each or of each column.

    Args:
        deviation, residual: of each; border: residual of the outer pixels of their rows beyond that.
        mean: (30, 90) of the left image, default: a texture; rim: deviation of the outer pixels.
    """
    shape = (30, 90)
    valid = np.ones(shape, np.uint8)
    match = MatchResult.empty(shape)
    match.residual[:] = match.residual_normalised[:] = np.rint(np.repeat(residual, 30) / RESIDUAL_STEP)
    outer = np.abs(np.arange(90) % 30 - 14.5) > 9
    match.residual[:, outer] += round(border / RESIDUAL_STEP)
    match.residual_normalised[:, outer] += round(border / RESIDUAL_STEP)
    match.absolute_phase[:] = np.repeat([0, 5000, 10000], 30)
    match.right_u[:], match.right_v[:] = 8 * np.arange(90), 8 * np.arange(30)[:, None]
    link = np.empty(shape, np.uint8)
    surface_links.links(
        len(valid), match.absolute_phase, match.right_u.view(np.int16), match.right_v.view(np.int16), 0, 0, link
    )
    surfaces = Surfaces(shape)
    assert surfaces.find(valid, link, 50) == 3
    deviations = np.where(outer, np.repeat(deviation if rim is None else rim, 30), np.repeat(deviation, 30))
    steps = np.tile(np.rint(deviations * DEVIATION_STEPS).astype(np.uint8), (30, 1))
    texture = np.random.default_rng(1).integers(60, 120, shape, np.uint8) if mean is None else mean
    component_test(valid, match, steps, texture, surfaces, 10**6, scale, 0.2, weight)
    return valid.mean(axis=0) if columns else valid.reshape(30, 3, 30).mean(axis=(0, 2))


@pytest.mark.parametrize(("residual", "textured", "inner", "side"), [
    (0.03, True, 1, 1), (0.03, False, 1, 0), (0.08, True, 1, 1), (0.08, False, 1, 0), (0.12, True, 1, 0),
])  # fmt: skip
def test_a_narrow_strip_at_the_images_side_needs_clear_evidence(
    residual: float, textured: bool, inner: int, side: int
) -> None:
    """Strips of 8 x 60 pixels: the first and the last end at a side of the image, the others do not."""
    shape = (60, 32)
    valid, match = np.ones(shape, np.uint8), MatchResult.empty(shape)
    match.residual[:] = match.residual_normalised[:] = round(residual / RESIDUAL_STEP)
    match.absolute_phase[:] = np.repeat([0, 5000, 10000, 15000], 8)
    match.right_u[:], match.right_v[:] = 8 * np.arange(32), 8 * np.arange(60)[:, None]
    link, surfaces = np.empty(shape, np.uint8), Surfaces(shape)
    surface_links.links(
        len(valid), match.absolute_phase, match.right_u.view(np.int16), match.right_v.view(np.int16), 0, 0, link
    )
    assert surfaces.find(valid, link, 50) == 4
    mean = np.random.default_rng(1).integers(60, 120, shape, np.uint8) if textured else np.full(shape, 80, np.uint8)
    deviation = np.full(shape, round(0.8 * DEVIATION_STEPS), np.uint8)
    component_test(valid, match, deviation, mean, surfaces, 10**6, TEXTURED, 0.2, 1.0)
    assert (valid.reshape(60, 4, 8).mean(axis=(0, 2)) == [side, inner, inner, side]).all()


def test_a_surface_of_foreign_texture_is_rejected_and_others_stay() -> None:
    assert (_tested([0.8, 8.0, 1.2], [0.03, 0.06, 0.03], TEXTURED) == [1, 0, 1]).all()


def test_a_surface_off_the_projectors_phase_is_rejected_whatever_its_texture() -> None:
    assert (_tested([0.8, 0.8, 0.8], [0.03, 0.25, -0.3], TEXTURED) == [1, 0, 0]).all()


def test_a_glossy_surface_stays_where_the_projector_agrees() -> None:
    assert (_tested([0.8, 8.0, 0.8], [0.03, 0.01, 0.03], TEXTURED) == [1, 1, 1]).all()


def test_a_uniform_surface_is_rejected_where_its_inside_is_off_the_projectors_phase() -> None:
    uniform = np.full((30, 90), 80, np.uint8)
    residual = [0.03, 0.11, 0.03]
    assert (_tested([0.8, 0.8, 0.8], residual, TEXTURED, mean=uniform) == [1, 0, 1]).all()
    assert (_tested([0.8, 0.8, 0.8], residual, TEXTURED) == [1, 1, 1]).all()


def test_residuals_at_the_border_of_a_surface_are_none_of_its_inside() -> None:
    uniform = np.full((30, 90), 80, np.uint8)
    assert (_tested([0.8, 0.8, 0.8], [0.03, 0.03, 0.03], TEXTURED, mean=uniform, border=0.12) == [1, 1, 1]).all()


def test_where_the_layout_is_blind_only_a_surface_with_texture_of_its_own_stays() -> None:
    mean = np.random.default_rng(2).integers(60, 120, (30, 90), np.uint8)
    mean[:, 30:60] = 80
    assert (_tested([0.8, 0.8, 0.8], [0.03, 0.03, 0.03], TEXTURED, mean=mean, weight=0.0) == [1, 0, 1]).all()
    assert (_tested([0.8, 0.8, 0.8], [0.03, 0.03, 0.03], TEXTURED, mean=mean, weight=1.0) == [1, 1, 1]).all()
