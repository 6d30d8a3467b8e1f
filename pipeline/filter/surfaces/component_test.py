"""Test of connected surfaces: do texture and projector agree with the surface as a whole?

A surface that areas seen by one camera only make up agrees in left and right phase by construction, but its texture is
that of two different places, and it has no reason to agree with the projector's phase. Both are counted as
logarithms of likelihood ratios, true against false.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import parallel
from pipeline.filter.occlusion.uniqueness import PARTS
from pipeline.filter.surfaces.connected_components import Surfaces
from pipeline.filter.texture_agreement import LOSS, Scale
from pipeline.match.match_result import RESIDUAL_STEP, MatchResult

_NO = np.uint8(0)
_LOSS_STEPS = 64.0
_LOSSES = np.rint(_LOSS_STEPS * LOSS).astype(np.int64)
_TEXTURE_PIXELS, _PHASE_PIXELS = 25.0, 120.0
"""Pixels that share one independent deviation of the texture, of the projector's phase."""
_TEXTURE_FLOOR = -2.0
"""Logarithm of the share of true surfaces, glossy ones, whose texture differs between the cameras."""
_PHASE_LIMIT, _TEXTURE_LIMIT = 3.0, 6.0
_NEUTRAL_RESIDUAL = 0.05
"""Rms of the phase against the projector at which it is no evidence, radians."""
_LOSS_VARIANCE = 0.5
_LARGE_STEP = 4
FALSE_SHARE, BLIND_SHARE = 0.3, 0.12
"""Share between both means at which the loss of a surface is no evidence: false ones agree in part, by chance and by
the search for the best order; the second where the projector's phase does not help."""
LEAST_RATIO = -1.0
"""Logarithm of the likelihood ratio below which a surface is rejected."""


@parallel
def _sums(
    part: int, valid: Any, first: Any, second: Any, deviation: Any, losses: Any, start: Any, stop: Any, count: Any, row:
    Any, surface: Any, size: Any, large: int, total: Any,
) -> None:  # fmt: skip
    """Sums of squared residuals and of losses, and pixels, of surfaces, (3, PARTS, surfaces) int64.

    Of surfaces from a size on some rows are enough.
    """
    height = valid.shape[0]
    parts = total.shape[1]
    for i in range(part * height // parts, (part + 1) * height // parts):
        for t in range(count[0, i]):
            k = surface[row[i] + t]
            if k < 0 or (size[k] >= large and i % _LARGE_STEP != 0):
                continue
            squares, loss, pixels = np.int64(0), np.int64(0), 0
            for j in range(start[i, t], stop[i, t]):
                if valid[i, j] != 0:
                    a, b = np.int64(first[i, j]), np.int64(second[i, j])
                    squares += min(a * a, b * b)
                    loss += losses[deviation[i, j]]
                    pixels += 1
            total[0, part, k] += squares
            total[1, part, k] += loss
            total[2, part, k] += pixels


@parallel
def reject_surfaces(
    i: int, rejected: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, valid: Any
) -> None:
    """Reject the pixels of runs of no surface and of rejected ones."""
    for t in range(count[0, i]):
        k = surface[row[i] + t]
        if k < 0 or rejected[k]:
            valid[i, start[i, t] : stop[i, t]] = _NO


def component_test(
    valid: NDArray[np.uint8], match: MatchResult, deviation: NDArray[np.uint8], surfaces: Surfaces, large: int,
    scale: Scale, largest_rms: float, phase_weight: float,
) -> None:  # fmt: skip
    """Reject surfaces that texture and projector contradict; ``valid`` is changed.

    Args:
        large: pixels from which only ``largest_rms`` counts: such surfaces set the textures' scale themselves.
        scale: of the textures' differences in this pair.
        largest_rms: of the phase against the projector, radians.
        phase_weight: 0..1, how far the projector's phase distinguishes fringe orders in this layout.
    """
    f = surfaces
    total = np.zeros((3, PARTS, len(f.sizes)), np.int64)
    _sums(
        PARTS, valid, match.residual_normalised, match.residual, deviation, _LOSSES, f.start, f.stop, f.count, f.first,
        f.surface, f.sizes, large, total,
    )  # fmt: skip
    squares, loss, pixels = total.sum(axis=1).astype(np.float64)
    n = np.maximum(pixels, 1)
    rms = RESIDUAL_STEP * np.sqrt(squares / n)
    ratio = log_likelihood_ratio(n, loss / n / _LOSS_STEPS, rms, scale, phase_weight)
    rejected = (rms > largest_rms) | ((f.sizes < large) & (ratio < LEAST_RATIO))
    reject_surfaces(len(valid), rejected, f.start, f.stop, f.count, f.first, f.surface, valid)


def log_likelihood_ratio(pixels: Any, mean_loss: Any, rms: Any, scale: Scale, phase_weight: float) -> Any:
    """Logarithm of the likelihood ratio of a surface, true against false, from its mean loss and phase residual.

    Losses of true and of false surfaces are taken as normal with the means of matched and of unrelated pixels.
    """
    apart = max(scale.unrelated_loss - scale.matched_loss, 0.0)
    middle = scale.matched_loss + (BLIND_SHARE + phase_weight * (FALSE_SHARE - BLIND_SHARE)) * apart
    texture = pixels / _TEXTURE_PIXELS * apart * (middle - mean_loss) / _LOSS_VARIANCE
    per = np.log(_NEUTRAL_RESIDUAL / np.maximum(rms, RESIDUAL_STEP))
    phase = np.clip(np.maximum(pixels / _PHASE_PIXELS, 1.0) * per, -_PHASE_LIMIT, _PHASE_LIMIT)
    return np.clip(texture, _TEXTURE_FLOOR, _TEXTURE_LIMIT) + phase_weight * phase
