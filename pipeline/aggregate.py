"""Semi-global aggregation with absolute fringe orders as labels.

Going from pixel q to p is free when the unwrapped phase is continuous: ``m_p = m_q + round((phi_q - phi_p) / 2 pi)``.
A sloping surface then costs nothing, however steep; any other change of order costs a penalty, less where the phase
itself shows a break. After Hirschmueller, PAMI 30 (2008), with another meaning of "smooth".
"""

from __future__ import annotations

from math import exp, pi
from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange, serial

_TWO_PI = 2 * pi


@serial
def _wrap(a: float) -> float:
    return a - _TWO_PI * np.rint(a / _TWO_PI)


@parallel
def links(phase: Any, valid: Any, rows: Any, columns: Any, slope: float, vertical: bool) -> tuple[Any, Any]:
    """How each lattice pixel is tied to its left (or upper) neighbour.

    Args:
        phase: (H, W) float32 wrapped phase; valid: (H, W) bool.
        slope: expected phase step per pixel, radians (nearly 0 across the fringes).

    Returns:
        jump (h, w) int8: change of order from the neighbour to here along a continuous surface.
        trust (h, w) float32: 0 (a break, or unknown) .. 1 (smooth phase).
    """
    h, w = rows.shape[0], columns.shape[0]
    jump = np.zeros((h, w), np.int8)
    trust = np.zeros((h, w), np.float32)
    for a in prange(h):
        for b in range(w):
            if (a == 0 and vertical) or (b == 0 and not vertical):
                continue
            i, j = rows[a], columns[b]
            di = rows[a] - rows[a - 1] if vertical else 0
            dj = 0 if vertical else columns[b] - columns[b - 1]
            steps = di + dj
            if not (valid[i, j] and valid[i - di, j - dj]):
                continue
            # Unwrap pixel by pixel along the way: robust for steep surfaces, and every break is seen.
            total = 0.0
            last = 0.0
            worst = 0.0
            whole = True
            for t in range(steps):
                y0, x0 = i - di + (t if vertical else 0), j - dj + (0 if vertical else t)
                y1, x1 = (y0 + 1, x0) if vertical else (y0, x0 + 1)
                whole = whole and valid[y1, x1]
                d = _wrap(phase[y1, x1] - phase[y0, x0] - slope) + slope
                if t > 0:
                    worst = max(worst, abs(d - last))
                last = d
                total += d
            jump[a, b] = np.int8(np.rint((phase[i - di, j - dj] + total - phase[i, j]) / _TWO_PI))
            if steps == 1:
                worst = 0.5 * abs(last - slope)
            trust[a, b] = exp(-worst * worst * 4.0) if whole else 0.15
    return jump, trust


@serial
def _step(cost: Any, previous: Any, current: Any, n_here: int, n_before: int, offset: int, penalty: float) -> None:
    """One step of a path: current(m) = cost(m) + min(previous(m - offset), min previous + penalty) - min previous."""
    low = np.float32(1e9)
    for k in range(n_before):
        low = min(low, previous[k])
    for k in range(n_here):
        best = penalty
        source = k + offset
        if 0 <= source < n_before:
            best = min(best, previous[source] - low)
        current[k] = cost[k] + best


@parallel
def along_rows(costs: Any, first: Any, count: Any, jump: Any, trust: Any, penalty: float, total: Any) -> None:
    """Add the two horizontal paths to ``total`` (h, w, labels)."""
    h, w, labels = costs.shape
    for a in prange(h):
        old, new = np.empty(labels, np.float32), np.empty(labels, np.float32)
        for direction in range(2):
            before = 0
            for t in range(w):
                b = t if direction == 0 else w - 1 - t
                n = count[a, b]
                if before == 0:
                    for k in range(n):
                        new[k] = costs[a, b, k]
                else:
                    q = b - 1 if direction == 0 else b + 1
                    tie = b if direction == 0 else q
                    change = jump[a, tie] if direction == 0 else -jump[a, tie]
                    offset = first[a, b] - change - first[a, q]
                    _step(costs[a, b], old, new, n, before, offset, penalty * trust[a, tie])
                for k in range(n):
                    total[a, b, k] += new[k]
                old, new = new, old
                before = n


@parallel
def along_columns(costs: Any, first: Any, count: Any, jump: Any, trust: Any, penalty: float, total: Any) -> None:
    """Add the two vertical paths to ``total``; columns in blocks, so that memory is walked in its own order."""
    h, w, labels = costs.shape
    block = 32
    for c in prange((w + block - 1) // block):
        b0, b1 = c * block, min((c + 1) * block, w)
        old, new = np.empty((block, labels), np.float32), np.empty((block, labels), np.float32)
        for direction in range(2):
            for t in range(h):
                a = t if direction == 0 else h - 1 - t
                q = a - 1 if direction == 0 else a + 1
                for b in range(b0, b1):
                    n = count[a, b]
                    before = count[q, b] if t > 0 else 0
                    if before == 0:
                        for k in range(n):
                            new[b - b0, k] = costs[a, b, k]
                    else:
                        tie = a if direction == 0 else q
                        change = jump[tie, b] if direction == 0 else -jump[tie, b]
                        offset = first[a, b] - change - first[q, b]
                        _step(costs[a, b], old[b - b0], new[b - b0], n, before, offset, penalty * trust[tie, b])
                    for k in range(n):
                        total[a, b, k] += new[b - b0, k]
                old, new = new, old


@parallel
def decide(total: Any, first: Any, count: Any) -> tuple[Any, Any]:
    """Best order (h, w) int16 (-32768 where there is none) and its lead over the second best (h, w) float32."""
    h, w, _ = total.shape
    order = np.full((h, w), np.int16(-32768))
    lead = np.zeros((h, w), np.float32)
    for a in prange(h):
        for b in range(w):
            best, second, where = np.float32(1e9), np.float32(1e9), -1
            for k in range(count[a, b]):
                value = total[a, b, k]
                if value < best:
                    best, second, where = value, best, k
                elif value < second:
                    second = value
            if where >= 0:
                order[a, b] = first[a, b] + where
                lead[a, b] = min(second - best, np.float32(99.0))
    return order, lead
