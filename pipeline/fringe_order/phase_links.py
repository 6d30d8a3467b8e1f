"""Links of neighbouring lattice pixels: the change of fringe order between them along a continuous surface."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import decay, whole_turns

_TURN, _FOUR, _EIGHT = np.float32(2 * pi), np.float32(4), np.float32(8)
_BROKEN = np.float32(0.15)
_ZERO, _HALF = np.float32(0), np.float32(0.5)


@inline
def _link(total: Any, before: Any, phase: Any, worst: Any, all_valid: bool) -> tuple[Any, Any]:
    """Change of order along a continuous surface, and its weight 0 .. 1, from the phase unwrapped in between."""
    sharp = min(_FOUR * worst * worst, _EIGHT)
    return whole_turns(before + total - phase), decay(sharp) if all_valid else _BROKEN


@inline
def row_links(phase: Any, valid: Any, j0: int, step: int, slope: Any, count: Any, jump: Any, weight: Any) -> None:
    """Link the lattice pixels of a row to their left neighbours.

    The phase is unwrapped pixel by pixel in between: robust on steep surfaces, and no break is missed.

    Args:
        phase, valid: a row of the image; lattice pixel b is its column ``j0 + step b``.
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
        jump[b], weight[b] = np.int32(change) if both else 0, smooth if both else _ZERO


@parallel
def column_links(
    a: int,
    phase: Any,
    valid: Any,
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
        jump[a, b], weight[a, b] = np.int32(change) if both else 0, smooth if both else _ZERO
