"""Links of neighbouring lattice pixels: the change of fringe order between them along a continuous surface.

A link has a weight, by which the penalty of another change of order is multiplied. Where the brightness changes, a
surface may end: as Hirschmueller (PAMI 30, 2008) lowers the penalty by the gradient of the image, the weight falls with
the contrast of both ends. Fringes may be left in the brightness, of saturated images above all. They fill the image,
while edges of surfaces are few: the median of an image's contrasts limits how much they count.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.common.jit import allocating, inline, linked
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import decay, whole_turns

_TURN, _FOUR, _EIGHT = np.float32(2 * pi), np.float32(4), np.float32(8)
_BROKEN = np.float32(0.15)
_ZERO, _HALF = np.float32(0), np.float32(0.5)
CONTRAST = 300.0
"""The weight of a link is multiplied by exp(-CONTRAST c^2), c the difference of its ends' brightness over their sum."""
_DARK = np.float32(32)
"""Added to that sum, counts: the noise of dark surfaces is no contrast."""
_TYPICAL = 0.013
"""Median contrast from which on it counts less."""
_ROWS, _COLUMNS = 8, 2
"""Every n-th row and column of a lattice is used for the median."""
_BINS, _LAST, _FINE = 128, np.float32(127), np.float32(1000)
"""Bins of the histogram of contrasts, the last one's number, and that of a contrast of 1."""


@inline
def _link(total: Any, before: Any, phase: Any, worst: Any, all_valid: bool) -> tuple[Any, Any]:
    """Change of order along a continuous surface, and its weight 0 .. 1, from the phase unwrapped in between."""
    sharp = min(_FOUR * worst * worst, _EIGHT)
    return whole_turns(before + total - phase), decay(sharp) if all_valid else _BROKEN


@inline
def _contrast(one: Any, other: Any) -> Any:
    """Contrast of two numbers of counts."""
    first, second = np.float32(one), np.float32(other)
    return (first - second) / (first + second + _DARK)


@inline
def _alike(one: Any, other: Any, factor: Any) -> Any:
    """Weight 0 .. 1 by the brightness of both ends of a link."""
    contrast = _contrast(one, other)
    return decay(min(factor * contrast * contrast, _EIGHT))


@inline
def _bin(one: Any, other: Any) -> Any:
    """Number of a contrast in the histogram."""
    contrast = _contrast(one, other)
    return np.int32(min(abs(contrast) * _FINE, _LAST))


@linked
def _limited_factor(histogram: Any) -> Any:
    """CONTRAST, or less where the median of the contrasts (bins,) is high."""
    total, below, median = histogram.sum(), 0, 0
    while median < histogram.shape[0] - 1 and 2 * (below + histogram[median]) < total:
        below += histogram[median]
        median += 1
    ratio: Any = min(_TYPICAL / ((median + 0.5) / _FINE), 1.0)
    return np.float32(CONTRAST * ratio * ratio)


@allocating
def contrast_factors(
    brightness: Any, valid: Any, i0: int, down: int, h: int, j0: int, step: int, w: int
) -> tuple[Any, Any]:
    """Factors of the squared contrasts of a lattice's links, along rows and along columns.

    Args:
        brightness: (H, W) uint8, counts; valid: (H, W) bool; the lattice as of :func:`column_links`, h by w.
    """
    along, across = np.zeros(_BINS, np.int64), np.zeros(_BINS, np.int64)
    for a in range(0, h - 1, _ROWS):
        i = i0 + down * a
        for b in range(0, w - 1, _COLUMNS):
            j = j0 + step * b
            if valid[i, j]:
                if valid[i, j + step]:
                    along[_bin(brightness[i, j], brightness[i, j + step])] += 1
                if valid[i + down, j]:
                    across[_bin(brightness[i, j], brightness[i + down, j])] += 1
    return _limited_factor(along), _limited_factor(across)


@inline
def row_links(
    phase: Any, valid: Any, brightness: Any, factor: Any, j0: int, step: int, slope: Any, count: Any, jump: Any,
    weight: Any,
) -> None:  # fmt: skip
    """Link the lattice pixels of a row to their left neighbours.

    The phase is unwrapped pixel by pixel in between: robust on steep surfaces, and no break is missed.

    Args:
        phase, valid, brightness: a row of the image; lattice pixel b is its column ``j0 + step b``.
        factor: of the squared contrast, 0 = the brightness does not count.
        slope: expected phase step per pixel, radians; count: (w,) labels of each; pixels with one label at most
            are not linked.
        jump: (w,) int32, change of order from the neighbour to the pixel along a continuous surface.
        weight: (w,) float32, 0 (a break, or unknown) .. 1 (smooth phase).
    """
    jump[0], weight[0] = 0, _ZERO
    for b in range(1, count.shape[0]):
        if count[b] <= 1 and count[b - 1] <= 1:
            continue
        m = np.uint32(j0 + step * (b - 1))
        total, last, worst, all_valid = _ZERO, _ZERO, _ZERO, True
        for s in range(step):
            d = phase[m + np.uint32(s + 1)] - phase[m + np.uint32(s)] - slope
            d -= _TURN * whole_turns(d)
            worst = max(worst, abs(d - last) if s > 0 else _ZERO)
            last = d
            total += d + slope
            all_valid &= valid[m + np.uint32(s + 1)]
        n = m + np.uint32(step)
        worst = _HALF * abs(last) if step == 1 else worst
        change, smooth = _link(total, phase[m], phase[n], worst, all_valid)
        both = valid[m] & valid[n]
        jump[b] = np.int32(change) if both else 0
        weight[b] = smooth * _alike(brightness[m], brightness[n], factor) if both else _ZERO


@parallel
def column_links(
    a: int,
    phase: Any,
    valid: Any,
    brightness: Any,
    factor: Any,
    i0: int,
    down: int,
    j0: int,
    step: int,
    slope: Any,
    count: Any,
    jump: Any,
    weight: Any,
) -> None:
    """Link each lattice pixel to its upper neighbour; as :func:`row_links`, for the whole lattice (h, w)."""
    w = jump.shape[1]
    if a == 0:
        jump[0, :] = 0
        weight[0, :] = _ZERO
        return
    top = i0 + down * (a - 1)
    for b in range(w):
        if count[a, b] <= 1 and count[a - 1, b] <= 1:
            continue
        m = np.uint32(j0 + step * b)
        total, last, worst, all_valid = _ZERO, _ZERO, _ZERO, True
        for s in range(down):
            d = phase[top + s + 1, m] - phase[top + s, m] - slope
            d -= _TURN * whole_turns(d)
            worst = max(worst, abs(d - last) if s > 0 else _ZERO)
            last = d
            total += d + slope
            all_valid &= valid[top + s + 1, m]
        worst = _HALF * abs(last) if down == 1 else worst
        change, smooth = _link(total, phase[top, m], phase[top + down, m], worst, all_valid)
        both = valid[top, m] & valid[top + down, m]
        jump[a, b] = np.int32(change) if both else 0
        weight[a, b] = smooth * _alike(brightness[top, m], brightness[top + down, m], factor) if both else _ZERO
