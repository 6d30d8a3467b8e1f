"""Quadratic polynomials over a patch, and cosine and sine of a quadratic phase (compiled)."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import allocating_linked, inline, serial

QUADRATIC = 6


@serial
def solved(matrix: Any, right: Any, n: int, columns: int) -> bool:
    """Solve the symmetric positive system in place (Cholesky); False where it is singular."""
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-9 * max(matrix[i, i], 1e-9):
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for c in range(columns):
        for i in range(n):
            total = right[i, c]
            for k in range(i):
                total -= matrix[i, k] * right[k, c]
            right[i, c] = total / matrix[i, i]
        for i in range(n - 1, -1, -1):
            total = right[i, c]
            for k in range(i + 1, n):
                total -= matrix[k, i] * right[k, c]
            right[i, c] = total / matrix[i, i]
    return True


@allocating_linked
def fit_quadratic(points: Any, n: int, u: int, centre_u: float, centre_v: float, half_u: float, half_v: float,
                  targets: Any, matrix: Any, right: Any) -> bool:  # fmt: skip
    """Least squares of some columns of ``points`` on 1, x, y, x x, x y, y y of columns u and u + 1; into ``right``."""
    matrix[:QUADRATIC, :QUADRATIC] = 0.0
    right[:QUADRATIC, : targets.shape[0]] = 0.0
    b = np.empty(QUADRATIC)
    for k in range(n):
        x, y = (points[k, u] - centre_u) / half_u, (points[k, u + 1] - centre_v) / half_v
        b[0], b[1], b[2], b[3], b[4], b[5] = 1.0, x, y, x * x, x * y, y * y
        for i in range(QUADRATIC):
            for j in range(i + 1):
                matrix[i, j] += b[i] * b[j]
            for c in range(targets.shape[0]):
                right[i, c] += b[i] * points[k, targets[c]]
    return solved(matrix, right, QUADRATIC, targets.shape[0])


@inline
def quadratic(q: Any, c: int, x: float, y: float) -> Any:
    """Value of column c of the polynomials ``q`` (6, n) at (x, y)."""
    return q[0, c] + x * (q[1, c] + x * q[3, c] + y * q[4, c]) + y * (q[2, c] + y * q[5, c])


@serial
def waves(q: Any, half_u: float, x0: float, y: float, n: int, cosine: Any, sine: Any) -> None:
    """Cosine and sine of the quadratic phase along a row, by recurrence: its second difference is constant."""
    d = 1.0 / half_u
    start = quadratic(q, 0, x0, y)
    step = quadratic(q, 0, x0 + d, y) - start
    bend = 2.0 * q[3, 0] * d * d
    c, s = np.cos(start), np.sin(start)
    tc, ts = np.cos(step), np.sin(step)
    bc, bs = np.cos(bend), np.sin(bend)
    for j in range(n):
        cosine[j], sine[j] = c, s
        c, s = c * tc - s * ts, c * ts + s * tc
        tc, ts = tc * bc - ts * bs, tc * bs + ts * bc
