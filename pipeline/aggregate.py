"""Semi-global aggregation with absolute fringe orders as labels.

Going from pixel q to p is free when the unwrapped phase is continuous: ``m_p = m_q + round((phi_q - phi_p) / 2 pi)``.
A sloping surface then costs nothing, however steep; any other change of order costs a penalty, less where the phase
itself shows a break. After Hirschmueller, PAMI 30 (2008), with another meaning of "smooth".

All labels of a pixel are handled at once: a path keeps ``lanes`` costs between two margins as wide, so that a change of
the first order is a shifted look at the same memory.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.candidates import NO_SUCH
from pipeline.kernels import inline, ordered, parallel, prange
from pipeline.tiles import decay, turns

LANES = 16
"""Labels are handled in groups of this many."""
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
def _advance(cost: Any, at: int, old: Any, new: Any, lanes: int, offset: int, penalty: Any) -> None:
    """One step of a path: new(m) = cost(m) + min(old(m - offset) - least old, penalty)."""
    least = old[lanes]
    for k in range(lanes):
        least = min(least, old[np.uint32(lanes + k)])
    source, target = np.uint32(lanes + min(max(offset, -lanes), lanes)), np.uint32(at)
    for group in range(0, lanes, LANES):
        for k in range(LANES):
            m = np.uint32(group + k)
            best = old[source + m] - least
            new[np.uint32(lanes) + m] = cost[target + m] + (best if best < penalty else penalty)


@ordered
def _restart(new: Any, lanes: int) -> None:
    """A path that knows nothing: all labels alike."""
    for k in range(lanes):
        new[np.uint32(lanes + k)] = NO_SUCH


@ordered
def _add(total: Any, at: int, path: Any, lanes: int) -> None:
    for k in range(lanes):
        total[np.uint32(at + k)] += path[np.uint32(lanes + k)]


@ordered
def along_row(
    costs: Any, first: Any, count: Any, jump: Any, trust: Any, penalty: Any, lanes: int, paths: Any, total: Any
) -> None:
    """Both horizontal paths of a lattice row.

    Args:
        costs, total: (w * lanes,), the second is written; first, count: (w,) first order, number of orders.
        paths: (2, 3 * lanes) scratch whose margins hold NO_SUCH.
    """
    w = first.shape[0]
    old, new = paths[0], paths[1]
    for direction in range(2):
        _restart(old, lanes)
        for t in range(w):
            b = t if direction == 0 else w - 1 - t
            if count[b] == 0:
                _restart(new, lanes)
            else:
                q = b - 1 if direction == 0 else b + 1
                tie = b if direction == 0 else q
                if t == 0:
                    offset, price = 0, penalty
                else:
                    change = jump[tie] if direction == 0 else -jump[tie]
                    offset, price = first[b] - change - first[q], penalty * trust[tie]
                _advance(costs, b * lanes, old, new, lanes, offset, price)
            if direction == 0:
                for k in range(lanes):
                    total[np.uint32(b * lanes + k)] = new[np.uint32(lanes + k)]
            else:
                _add(total, b * lanes, new, lanes)
            old, new = new, old


@ordered
def _least(total: Any, at: int, lanes: int) -> int:
    """Label of the least value; the first one of several."""
    least = total[np.uint32(at)]
    for k in range(lanes):
        least = min(least, total[np.uint32(at + k)])
    where = lanes
    for k in range(lanes):
        where = min(where, k if total[np.uint32(at + k)] == least else lanes)
    return where


@parallel
def along_columns(
    costs: Any, first: Any, count: Any, jump: Any, trust: Any, penalty: Any, lanes: int, total: Any, order: Any
) -> None:
    """Both vertical paths, and the decision: ``order`` (h, w) int16, NONE where there are no candidates.

    Columns go in blocks, one thread each, so that memory is walked in its own order.

    Args:
        costs, total: (h, w * lanes); first, count: (h, w) int32; jump, trust: (h, w), from :func:`column_links`.
    """
    h, w = first.shape
    block = 16
    for group in prange((w + block - 1) // block):
        b0, b1 = group * block, min(w, group * block + block)
        size = 3 * lanes
        old, new = np.full((block, size), NO_SUCH), np.full((block, size), NO_SUCH)
        for direction in range(2):
            old[:] = NO_SUCH
            for t in range(h):
                a = t if direction == 0 else h - 1 - t
                q = a - 1 if direction == 0 else a + 1
                for b in range(b0, b1):
                    here, there = new[b - b0], old[b - b0]
                    if count[a, b] == 0:
                        _restart(here, lanes)
                        if direction == 1:
                            order[a, b] = NONE
                        continue
                    if t == 0:
                        offset, price = 0, penalty
                    else:
                        tie = a if direction == 0 else q
                        change = jump[tie, b] if direction == 0 else -jump[tie, b]
                        offset, price = first[a, b] - change - first[q, b], penalty * trust[tie, b]
                    _advance(costs[a], b * lanes, there, here, lanes, offset, price)
                    _add(total[a], b * lanes, here, lanes)
                    if direction == 1:
                        order[a, b] = first[a, b] + _least(total[a], b * lanes, lanes)
                old, new = new, old
