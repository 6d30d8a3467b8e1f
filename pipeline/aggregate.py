"""Semi-global aggregation with absolute fringe orders as labels.

Going from pixel q to p is free when the unwrapped phase is continuous: ``m_p = m_q + round((phi_q - phi_p) / 2 pi)``.
A sloping surface then costs nothing, however steep; any other change of order costs a penalty, less where the phase
itself shows a break. After Hirschmueller, PAMI 30 (2008), with another meaning of "smooth".

A path keeps the costs of a pixel's labels between two margins as wide, so that a change of the first order is a shifted
look at the same memory.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.candidates import NO_SUCH
from pipeline.kernels import inline, ordered, parallel, prange
from pipeline.tiles import decay, turns

BLOCK = 16
"""Columns whose paths go down together: the costs of a row of them are neighbours in memory."""
NONE = -32768
"""Order of a pixel that has none."""
_TURN, _FOUR, _EIGHT = np.float32(2 * pi), np.float32(4), np.float32(8)
_BROKEN = np.float32(0.15)
_ZERO, _HALF = np.float32(0), np.float32(0.5)


@inline
def _tie(total: Any, before: Any, here: Any, worst: Any, whole: bool) -> tuple[Any, Any]:
    """Change of order along a continuous surface, and trust 0 .. 1 in it, from the unwrapped way between two pixels."""
    sharp = min(_FOUR * worst * worst, _EIGHT)
    return turns(before + total - here), decay(sharp) if whole else _BROKEN


@inline
def row_links(phase: Any, valid: Any, j0: int, step: int, slope: Any, w: int, jump: Any, trust: Any) -> None:
    """How the lattice pixels of a row are tied to their left neighbours.

    The phase is unwrapped pixel by pixel along the way: robust for steep surfaces, and every break is seen.

    Args:
        phase, valid: a row of the picture; lattice pixel b is its column ``j0 + step b``.
        slope: expected phase step per pixel, radians.
        jump: (w,) int32, change of order from the neighbour to here along a continuous surface.
        trust: (w,) float32, 0 (a break, or unknown) .. 1 (smooth phase).
    """
    jump[0], trust[0] = 0, _ZERO
    for b in range(1, w):
        m = np.uint32(j0 + step * (b - 1))
        total, last, worst, whole = _ZERO, _ZERO, _ZERO, True
        for s in range(step):
            d = phase[m + np.uint32(s + 1)] - phase[m + np.uint32(s)] - slope
            d -= _TURN * turns(d)
            worst = max(worst, abs(d - last) if s > 0 else _ZERO)
            last = d
            total += d + slope
            whole &= valid[m + np.uint32(s + 1)]
        n = m + np.uint32(step)
        worst = _HALF * abs(last) if step == 1 else worst
        change, trusted = _tie(total, phase[m], phase[n], worst, whole)
        both = valid[m] & valid[n]
        jump[b], trust[b] = np.int32(change) if both else 0, trusted if both else _ZERO


@parallel
def column_links(
    phase: Any, valid: Any, i0: int, down: int, j0: int, step: int, slope: Any, jump: Any, trust: Any
) -> None:
    """How each lattice pixel is tied to its upper neighbour; as :func:`row_links`, for the whole lattice (h, w)."""
    h, w = jump.shape
    for a in prange(h):
        if a == 0:
            jump[0, :] = 0
            trust[0, :] = _ZERO
            continue
        top = i0 + down * (a - 1)
        for b in range(w):
            m = np.uint32(j0 + step * b)
            total, last, worst, whole = _ZERO, _ZERO, _ZERO, True
            for s in range(down):
                d = phase[top + s + 1, m] - phase[top + s, m] - slope
                d -= _TURN * turns(d)
                worst = max(worst, abs(d - last) if s > 0 else _ZERO)
                last = d
                total += d + slope
                whole &= valid[top + s + 1, m]
            worst = _HALF * abs(last) if down == 1 else worst
            change, trusted = _tie(total, phase[top, m], phase[top + down, m], worst, whole)
            both = valid[top, m] & valid[top + down, m]
            jump[a, b], trust[a, b] = np.int32(change) if both else 0, trusted if both else _ZERO


@ordered
def _advance(
    cost: Any, at: int, n: int, old: Any, least: Any, new: Any, before: int, labels: int, offset: int, penalty: Any
) -> Any:
    """One step of a path: new(m) = cost(m) + min(old(m - offset) - least old, penalty); returns the least new.

    Paths hold ``labels`` costs between two margins as wide; NO_SUCH beyond the labels there are, ``before`` of them in
    ``new`` so far.
    """
    source = np.uint32(labels + min(max(offset, -labels), labels))
    target, base = np.uint32(at), np.uint32(labels)
    least_new = NO_SUCH
    for k in range(np.uint32(n)):
        best = old[source + k] - least
        value = cost[target + k] + (best if best < penalty else penalty)
        new[base + k] = value
        least_new = value if value < least_new else least_new
    for k in range(n, before):
        new[np.uint32(labels + k)] = NO_SUCH
    return least_new


@ordered
def along_row(
    costs: Any, first: Any, count: Any, jump: Any, trust: Any, penalty: Any, labels: int, paths: Any, total: Any
) -> None:
    """Both horizontal paths of a lattice row.

    Args:
        costs, total: (w * labels,), the second is written; first, count: (w,) first order, number of orders.
        paths: (2, 3 * labels) scratch, all NO_SUCH.
    """
    w = first.shape[0]
    old, new = paths[0], paths[1]
    old_n, new_n = 0, 0
    for direction in range(2):
        least = NO_SUCH
        for t in range(w):
            b = t if direction == 0 else w - 1 - t
            n, at = count[b], b * labels
            offset, price = 0, penalty
            if t > 0 and n > 0:
                q, tie = (b - 1, b) if direction == 0 else (b + 1, b + 1)
                change = jump[tie] if direction == 0 else -jump[tie]
                offset, price = first[b] - change - first[q], penalty * trust[tie]
            least = _advance(costs, at, n, old, least, new, new_n, labels, offset, price)
            target, base = np.uint32(at), np.uint32(labels)
            if direction == 0:
                for k in range(np.uint32(n)):
                    total[target + k] = new[base + k]
            else:
                for k in range(np.uint32(n)):
                    total[target + k] += new[base + k]
            old, new, old_n, new_n = new, old, n, old_n
        old[:] = NO_SUCH
        old_n = 0


@parallel
def along_columns(
    costs: Any, first: Any, count: Any, jump: Any, trust: Any, penalty: Any, labels: int, total: Any, order: Any
) -> None:
    """Both vertical paths, and the decision: ``order`` (h, w) int16, NONE where there are no candidates.

    Columns go in blocks, one thread each, so that memory is walked in its own order.

    Args:
        costs, total: (h, w * labels); first, count: (h, w) int32; jump, trust: (h, w), from :func:`column_links`.
    """
    h, w = first.shape
    for group in prange((w + BLOCK - 1) // BLOCK):
        b0, b1 = group * BLOCK, min(w, group * BLOCK + BLOCK)
        old, new = np.full((BLOCK, 3 * labels), NO_SUCH), np.full((BLOCK, 3 * labels), NO_SUCH)
        old_n, new_n = np.zeros(BLOCK, np.int32), np.zeros(BLOCK, np.int32)
        least = np.full(BLOCK, NO_SUCH)
        for direction in range(2):
            for t in range(h):
                a = t if direction == 0 else h - 1 - t
                q, tie = (a - 1, a) if direction == 0 else (a + 1, a + 1)
                row_costs, row_total = costs[a], total[a]
                for b in range(b0, b1):
                    p = b - b0
                    n, at = count[a, b], b * labels
                    offset, price = 0, penalty
                    if t > 0 and n > 0:
                        change = jump[tie, b] if direction == 0 else -jump[tie, b]
                        offset, price = first[a, b] - change - first[q, b], penalty * trust[tie, b]
                    here = new[p]
                    least[p] = _advance(row_costs, at, n, old[p], least[p], here, new_n[p], labels, offset, price)
                    new_n[p] = n
                    target, base = np.uint32(at), np.uint32(labels)
                    if direction == 0:
                        for k in range(np.uint32(n)):
                            row_total[target + k] += here[base + k]
                        continue
                    best, where = NO_SUCH + NO_SUCH, NONE - first[a, b]
                    for k in range(np.uint32(n)):
                        sum_ = row_total[target + k] + here[base + k]
                        where = np.int32(k) if sum_ < best else where
                        best = sum_ if sum_ < best else best
                    order[a, b] = first[a, b] + where
                old, new, old_n, new_n = new, old, new_n, old_n
            old[:] = NO_SUCH
            old_n[:] = 0
            least[:] = NO_SUCH
