"""Semi-global aggregation with absolute fringe orders as labels.

Going from pixel q to p is free when the unwrapped phase is continuous: ``m_p = m_q + round((phi_q - phi_p) / 2 pi)``.
A sloping surface then costs nothing, however steep; any other change of order costs a penalty, less where the phase
itself shows a break. After Hirschmueller, PAMI 30 (2008), with another meaning of "smooth".

A path keeps the costs of a pixel's labels between two margins as wide, so that a change of the first order is an offset
in the same memory. The number of labels is a multiple of the vectors' lanes (:mod:`.label_vectors`); all are treated
alike, whether the pixel has them (else the cost is COST_IMPOSSIBLE) or not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, ordered
from pipeline.common.parallel_for import parallel_allocating
from pipeline.fringe_order.label_vectors import advance, least_two
from pipeline.fringe_order.order_candidates import COST_IMPOSSIBLE

BLOCK = 16
"""Columns whose paths are followed together: the costs of a row of them are neighbours in memory."""
NONE = -32768
"""Order of a pixel that has none."""
_ZERO, _ONE = np.float32(0), np.float32(1)


@inline
def _displaced(old: int, labels: int, offset: int) -> int:
    """Where the neighbour's cost of a pixel's first label lies in ``paths``."""
    return old + labels + min(max(offset, -labels), labels)


@ordered
def _start_path(paths: Any, old: int, labels: int, n: int) -> Any:
    """Start a path at a pixel without labels (n = 0) or with a single one (n = 1); returns its least cost."""
    for k in range(labels):
        paths[np.uint32(old + labels + k)] = COST_IMPOSSIBLE
    if n == 1:
        paths[np.uint32(old + labels)] = _ZERO
        return _ZERO
    return COST_IMPOSSIBLE


@ordered
def along_row(
    costs: Any, place: Any, first: Any, count: Any, jump: Any, weight: Any, penalty: Any, labels: int, paths: Any,
    total: Any,
) -> None:  # fmt: skip
    """Both horizontal paths of a lattice row.

    Args:
        costs, total: flat, COST_IMPOSSIBLE for labels that a pixel does not have; the second is written where
            there are several labels; place: (w,) int32, where a pixel's labels begin in both.
        first, count: (w,) first order, number of orders.
        paths: (6 * labels,) scratch, COST_IMPOSSIBLE.
    """
    w = first.shape[0]
    old, new = 0, 3 * labels
    for direction in range(2):
        last, least, keep = 0, COST_IMPOSSIBLE, np.float32(direction)
        for t in range(w):
            b = t if direction == 0 else w - 1 - t
            if count[b] <= 1:
                last = count[b]
                continue
            offset, switch_cost = 0, penalty
            if t > 0:
                q, link = (b - 1, b) if direction == 0 else (b + 1, b + 1)
                change = jump[link] if direction == 0 else -jump[link]
                offset, switch_cost = first[b] - change - first[q], penalty * weight[link]
            if last <= 1:
                least = _start_path(paths, old, labels, last)
            least = advance(costs, place[b], paths, _displaced(old, labels, offset), new + labels, least, switch_cost,
                            keep, total, labels)  # fmt: skip
            old, new, last = new, old, count[b]


@parallel_allocating
def along_columns(
    group: int, costs: Any, place: Any, first: Any, count: Any, jump: Any, weight: Any, penalty: Any, labels: int,
    margin: Any, total: Any, order: Any, confident: Any,
) -> None:  # fmt: skip
    """Both vertical paths, and the decision.

    Blocks of columns, one thread each, are read in the order of the memory.

    Args:
        costs, total: flat; place, first, count: (h, w) int32, as of :func:`along_row`.
        jump, weight: (h, w), of :func:`pipeline.fringe_order.phase_links.column_links`.
        margin: lead of the best total over the second best from which a decision is confident.
        order: (h, w) int16, written, NONE where there are no candidates; confident: (h, w) uint8, written, 1 where
            there is one candidate only or its lead is large enough, else 0.
    """
    h, w = first.shape
    b0, b1 = group * BLOCK, min(w, group * BLOCK + BLOCK)
    # An index without sign cannot count from the end: the compiler needs no test, and loads whole vectors.
    start, end = np.uint64(b0), np.uint64(b1)
    size = 3 * labels
    paths = np.full(2 * BLOCK * size, COST_IMPOSSIBLE)
    least, last, side = np.full(BLOCK, COST_IMPOSSIBLE), np.zeros(BLOCK, np.int32), np.zeros(BLOCK, np.int32)
    for direction in range(2):
        last[:] = 0
        for t in range(h):
            a = t if direction == 0 else h - 1 - t
            q, link = (a - 1, a) if direction == 0 else (a + 1, a + 1)
            most, row = np.int32(0), np.uint64(a)
            for c in range(start, end):
                most = max(most, count[row, c])
            if most <= 1:
                for c in range(start, end):
                    last[c - start] = count[row, c]
                if direction == 1:
                    for c in range(start, end):
                        one, none = np.int16(first[row, c]), np.int16(NONE)
                        order[row, c], confident[row, c] = one if count[row, c] == 1 else none, count[row, c]
                continue
            for b in range(b0, b1):
                n, p = count[a, b], b - b0
                if n <= 1:
                    last[p] = n
                    if direction == 1:
                        order[a, b], confident[a, b] = first[a, b] if n == 1 else NONE, n
                    continue
                at, offset, switch_cost = np.int64(place[a, b]), 0, penalty
                if t > 0:
                    change = jump[link, b] if direction == 0 else -jump[link, b]
                    offset, switch_cost = first[a, b] - change - first[q, b], penalty * weight[link, b]
                old = (2 * p + side[p]) * size
                new = (2 * p + 1 - side[p]) * size
                if last[p] <= 1:
                    least[p] = _start_path(paths, old, labels, last[p])
                least[p] = advance(costs, at, paths, _displaced(old, labels, offset), new + labels, least[p],
                                   switch_cost, _ONE, total, labels)  # fmt: skip
                last[p], side[p] = n, 1 - side[p]
                if direction == 1:
                    where, lead = least_two(total, at, labels)
                    order[a, b], confident[a, b] = first[a, b] + where, 1 if lead >= margin else 0
