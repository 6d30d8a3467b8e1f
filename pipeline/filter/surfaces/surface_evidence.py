"""Evidence that connected surfaces are true: logarithms of likelihood ratios, from their texture and their phase."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pipeline.filter.texture_agreement import Scale
from pipeline.match.match_result import RESIDUAL_STEP

DISTINCT = 0.5
"""Weight of the projector's phase from which it is taken to distinguish fringe orders."""
_TEXTURE_PIXELS, _PHASE_PIXELS = 25.0, 120.0
"""Pixels that share one independent deviation of the texture, of the projector's phase."""
_TEXTURE_FLOOR = -2.0
"""Logarithm of the share of true surfaces, glossy ones, whose texture differs between the cameras."""
_PHASE_LIMIT, _TEXTURE_LIMIT, _UNIFORM_LIMIT = 3.0, 6.0, 1.0
"""Most evidence of the projector's phase, of a texture, and of a texture that agrees at displaced places as well."""
_NEUTRAL_RESIDUAL, _NEUTRAL_INSIDE = 0.05, 0.07
"""Rms of the phase against the projector at which it is no evidence, radians; the second inside a surface whose
texture agrees."""
_LOSS_VARIANCE = 0.5
FALSE_SHARE, BLIND_SHARE = 0.3, 0.12
"""Share between both means at which the loss of a surface is no evidence: false ones agree in part, by chance and by
the search for the best order; the second where the projector's phase does not help."""
_TEXTURES_INSIDE, _INSIDE_LEAST, _INSIDE_LIMIT = 100, 0.5, 1.9
"""Pixels inside from which their texture counts alone, least evidence of it, and most: less than the phase's against a
surface."""


class Figures(NamedTuple):
    """What is known of surfaces, (n,) each.

    Args:
        pixels: their number; mean_loss: of the textures' deviations between the cameras.
        rms: phase against the projector, radians; rms_inside: the same away from the surface's border, NaN where it
            has no inside.
        inside, loss_inside: pixels there, and the mean loss of their deviations.
        own_loss: mean loss of the deviations in the left image between pixels a fixed distance apart; NaN for surfaces
            too narrow for it.
        at_side: bool, most of its rows are narrower than that and end at the image's left or right side.
    """

    pixels: Any
    mean_loss: Any
    rms: Any
    rms_inside: Any
    inside: Any
    loss_inside: Any
    own_loss: Any
    at_side: Any


def log_likelihood_ratio(figures: Figures, scale: Scale, phase_weight: float) -> Any:
    """Logarithm of the likelihood ratio of surfaces (n,), true against false, from texture and phase residual."""
    whole, own = _texture(figures, figures.pixels, figures.mean_loss, scale, phase_weight)
    texture = np.clip(np.minimum(whole, _UNIFORM_LIMIT + np.maximum(own, 0.0)), _TEXTURE_FLOOR, _TEXTURE_LIMIT)
    return texture + phase_weight * _phase(figures, texture)


def ratio_of_inside(figures: Figures, scale: Scale, phase_weight: float) -> Any:
    """The same with the texture inside, for surfaces (n,) with enough of it that agrees; -inf for the others.

    At the border of a surface windows see two textures: where many of its pixels are near one, their loss is that of a
    false surface. A texture that agrees inside, and would not at displaced places, is evidence in spite of it.
    """
    whole, own = _texture(figures, figures.inside, figures.loss_inside, scale, phase_weight)
    texture = np.minimum(np.minimum(whole, own), _INSIDE_LIMIT)
    some = ~np.isnan(figures.rms_inside) & (figures.inside >= _TEXTURES_INSIDE) & (texture >= _INSIDE_LEAST)
    return np.where(some, texture + phase_weight * _phase(figures, texture), -np.inf)


def _texture(figures: Figures, pixels: Any, loss: Any, scale: Scale, phase_weight: float) -> tuple[Any, Any]:
    """Evidence of textures (n,) as against unrelated ones, and as against what the surface's own distinguishes.

    Losses of true and of false surfaces are taken as normal with the means of matched and of unrelated pixels, and for
    what the surface's own texture distinguishes with its own mean.
    """
    share = BLIND_SHARE + phase_weight * (FALSE_SHARE - BLIND_SHARE)
    apart = max(scale.unrelated_loss - scale.matched_loss, 0.0)
    own = np.where(np.isnan(figures.own_loss), apart, np.clip(figures.own_loss - scale.matched_loss, 0.0, apart))

    def evidence(apart: Any) -> Any:
        middle = scale.matched_loss + share * apart
        return pixels / _TEXTURE_PIXELS * apart * (middle - loss) / _LOSS_VARIANCE

    return evidence(apart), evidence(own)


def _phase(figures: Figures, texture: Any) -> Any:
    """Evidence of the phase against the projector, (n,)."""
    known = ~np.isnan(figures.rms_inside)
    neutral = np.where(known & (texture > 0), _NEUTRAL_INSIDE, _NEUTRAL_RESIDUAL)
    per = np.log(neutral / np.maximum(np.where(known, figures.rms_inside, figures.rms), RESIDUAL_STEP))
    return np.clip(np.maximum(figures.pixels / _PHASE_PIXELS, 1.0) * per, -_PHASE_LIMIT, _PHASE_LIMIT)
