"""Test of connected surfaces: do texture and projector agree with the surface as a whole?

A surface that areas seen by one camera only make up agrees in left and right phase by construction, but its texture is
that of two different places, and it has no reason to agree with the projector's phase. Both are counted as
logarithms of likelihood ratios, true against false. A texture that would agree at displaced places as well, as that of
a bare wall, is hardly any evidence for a surface. See :mod:`pipeline.filter.surfaces.surface_evidence`.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import Surfaces
from pipeline.common.jit import linked
from pipeline.common.parallel_for import parallel
from pipeline.filter.occlusion.uniqueness import PARTS
from pipeline.filter.surfaces.surface_evidence import DISTINCT, Figures, log_likelihood_ratio, ratio_of_inside
from pipeline.filter.texture_agreement import AMPLITUDE_SHARE, DEVIATION_STEPS, LOSS, Scale
from pipeline.match.match_result import RESIDUAL_STEP, MatchResult

_NO = np.uint8(0)
_LOSS_STEPS = 64.0
_LOSSES = np.rint(_LOSS_STEPS * LOSS).astype(np.int64)
_LARGE_STEP = 4
LEAST_RATIO, LEAST_BLIND = -1.0, 1.5
"""Logarithm of the likelihood ratio below which a surface is rejected; the second where the projector's phase does not
help: there wrong orders are as probable as right ones before texture is considered."""
LEAST_AT_SIDE = 3.5
"""The same of narrow surfaces at the image's left or right side: many strips there are seen by one camera alone."""
DISPLACED, INSET = 10, 6
"""Pixels of the image between which a surface's own texture is compared, and from the ends of its rows to its inside,
where no window of the phase reaches its border."""
_LEAST_INSIDE, _LEAST_PAIRS = 0.25, 0.4
"""Share of a surface's pixels that must be inside, or be compared with others; the latter is not asked where the
projector's phase does not distinguish orders."""
_AGREEING = 3 * DEVIATION_STEPS // 2
"""Deviation up to which pixels of a surface stay for which only its inside is evidence; around it may be another."""
_SUMS = 9
_SQUARES, _LOSS, _PIXELS, _SQUARES_INSIDE, _LOSS_INSIDE, _PIXELS_INSIDE, _OWN_LOSS, _PAIRS, _AT_SIDE = range(_SUMS)


@parallel
def _sums(
    part: int, valid: Any, first: Any, second: Any, deviation: Any, losses: Any, start: Any, stop: Any, count: Any, row:
    Any, surface: Any, size: Any, large: int, total: Any,
) -> None:  # fmt: skip
    """Sums of squared residuals and of losses, and pixels, of surfaces, (9, PARTS, surfaces) int64.

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
            total[_SQUARES, part, k] += squares
            total[_LOSS, part, k] += loss
            total[_PIXELS, part, k] += pixels


@linked
def _own_loss(valid: Any, mean: Any, valid0: Any, mean0: Any, per: Any, losses: Any) -> tuple[Any, int]:
    """Sum of the losses between pixels (n,) and others of the same surface, and how many are both known."""
    loss, pairs = np.int64(0), 0
    for j in range(valid.shape[0]):
        if valid[j] != 0 and valid0[j] != 0:
            a, b = np.float32(mean[j]), np.float32(mean0[j])
            loss += losses[np.int32(min(per * abs(a - b) / (a + b + np.float32(2.0)), np.float32(254.0)))]
            pairs += 1
    return loss, pairs


@parallel
def _sums_of_small(
    part: int, valid: Any, first: Any, second: Any, deviation: Any, mean: Any, displaced: int, inset: int, per: Any,
    losses: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, size: Any, large: int, total: Any,
) -> None:  # fmt: skip
    """The other sums of surfaces below a size: of residuals and losses inside, and of losses of their own texture.

    Narrow runs have no pixels so far apart. At the image's side they are compared with those as many rows above.
    """
    height = valid.shape[0]
    parts = total.shape[1]
    for i in range(part * height // parts, (part + 1) * height // parts):
        for t in range(count[0, i]):
            k = surface[row[i] + t]
            if k < 0 or size[k] >= large:
                continue
            squares, loss_inside, pixels, begin, end = np.int64(0), np.int64(0), 0, start[i, t], stop[i, t]
            for j in range(begin + inset, end - inset):
                if valid[i, j] != 0:
                    a, b = np.int64(first[i, j]), np.int64(second[i, j])
                    squares += min(a * a, b * b)
                    loss_inside += losses[deviation[i, j]]
                    pixels += 1
            wide = end - begin > displaced
            at_side = not wide and (begin == 0 or end == valid.shape[1])
            up, back = displaced if at_side else 0, displaced if wide else 0
            loss, pairs = np.int64(0), 0
            if up + back > 0 and i >= up:
                loss, pairs = _own_loss(valid[i, begin + back : end], mean[i, begin + back : end],
                                        valid[i - up, begin : end - back], mean[i - up, begin : end - back], per,
                                        losses)  # fmt: skip
            total[_SQUARES_INSIDE, part, k] += squares
            total[_LOSS_INSIDE, part, k] += loss_inside
            total[_PIXELS_INSIDE, part, k] += pixels
            total[_OWN_LOSS, part, k] += loss
            total[_PAIRS, part, k] += pairs
            total[_AT_SIDE, part, k] += end - begin if at_side else 0


@parallel
def reject_surfaces(
    i: int, rejected: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, valid: Any
) -> None:
    """Reject the pixels of runs of no surface and of rejected ones."""
    for t in range(count[0, i]):
        k = surface[row[i] + t]
        if k < 0 or rejected[k]:
            valid[i, start[i, t] : stop[i, t]] = _NO


@parallel
def _reject_deviating(
    i: int, doubtful: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, deviation: Any, valid: Any
) -> None:
    """Reject the pixels of doubtful surfaces that do not agree themselves."""
    for t in range(count[0, i]):
        k = surface[row[i] + t]
        if k >= 0 and doubtful[k]:
            for j in range(start[i, t], stop[i, t]):
                valid[i, j] &= np.uint8(deviation[i, j] <= _AGREEING)


def component_test(
    valid: NDArray[np.uint8], match: MatchResult, deviation: NDArray[np.uint8], mean: NDArray[np.uint8],
    surfaces: Surfaces, large: int, scale: Scale, largest_rms: float, phase_weight: float, stride: int = 1,
) -> Figures:  # fmt: skip
    """Reject surfaces that texture and projector contradict, and return the figures of all; ``valid`` is changed.

    Args:
        mean: (H, W) of the left image, counts.
        large: pixels from which only ``largest_rms`` counts: such surfaces set the textures' scale themselves.
        scale: of the textures' differences in this pair.
        largest_rms: of the phase against the projector, radians.
        phase_weight: 0..1, how far the projector's phase distinguishes fringe orders in this layout.
        stride: pixels of the image from one of these pixels to the next.
    """
    f = surfaces
    total = _summed(valid, match, deviation, f, large)
    runs = f.start, f.stop, f.count, f.first, f.surface, f.sizes, large
    residuals = match.residual_normalised, match.residual
    per = np.float32(2 * sqrt(1 - AMPLITUDE_SHARE) / scale.mean_sigma * DEVIATION_STEPS)
    displaced, inset = max(round(DISPLACED / stride), 1), round(INSET / stride)
    _sums_of_small(PARTS, valid, *residuals, deviation, mean, displaced, inset, per, _LOSSES, *runs, total)
    figures = _figures(total.sum(axis=1).astype(np.float64), 0.0 if phase_weight < DISTINCT else _LEAST_PAIRS)
    least = np.where(figures.at_side, LEAST_AT_SIDE, LEAST_BLIND + phase_weight * (LEAST_RATIO - LEAST_BLIND))
    doubtful = (f.sizes < large) & (log_likelihood_ratio(figures, scale, phase_weight) < least)
    partly = doubtful & (ratio_of_inside(figures, scale, phase_weight) >= least)
    rejected = (figures.rms > largest_rms) | (doubtful & ~partly)
    reject_surfaces(len(valid), rejected, f.start, f.stop, f.count, f.first, f.surface, valid)
    _reject_deviating(len(valid), partly, f.start, f.stop, f.count, f.first, f.surface, deviation, valid)
    return figures


def rms_of(
    valid: NDArray[np.uint8], match: MatchResult, deviation: NDArray[np.uint8], surfaces: Surfaces, large: int
) -> NDArray[np.float64]:
    """Rms of surfaces' (n,) residuals against the projector, radians; of some rows of those of ``large`` pixels."""
    total = _summed(valid, match, deviation, surfaces, large).sum(axis=1)
    return np.asarray(RESIDUAL_STEP * np.sqrt(total[_SQUARES] / np.maximum(total[_PIXELS], 1)))


def _summed(
    valid: NDArray[np.uint8], match: MatchResult, deviation: NDArray[np.uint8], surfaces: Surfaces, large: int
) -> NDArray[np.int64]:
    """Sums (9, PARTS, n) of :func:`_sums`, zeros for the others."""
    f = surfaces
    total = np.zeros((_SUMS, PARTS, len(f.sizes)), np.int64)
    _sums(
        PARTS, valid, match.residual_normalised, match.residual, deviation, _LOSSES, f.start, f.stop, f.count, f.first,
        f.surface, f.sizes, large, total,
    )  # fmt: skip
    return total


def _figures(total: NDArray[np.float64], least_pairs: float) -> Figures:
    """Figures from sums (9, n)."""
    n = np.maximum(total[_PIXELS], 1)
    inside, pairs = total[_PIXELS_INSIDE], total[_PAIRS]
    rms_inside = RESIDUAL_STEP * np.sqrt(total[_SQUARES_INSIDE] / np.maximum(inside, 1))
    own = total[_OWN_LOSS] / np.maximum(pairs, 1) / _LOSS_STEPS
    return Figures(
        n, total[_LOSS] / n / _LOSS_STEPS, RESIDUAL_STEP * np.sqrt(total[_SQUARES] / n),
        np.where(inside < np.maximum(_LEAST_INSIDE * n, 1), np.nan, rms_inside), inside,
        total[_LOSS_INSIDE] / np.maximum(inside, 1) / _LOSS_STEPS,
        np.where(pairs < least_pairs * n, np.nan, own), 2 * total[_AT_SIDE] > n,
    )  # fmt: skip
