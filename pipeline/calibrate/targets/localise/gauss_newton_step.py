"""One Gauss-Newton step: a small symmetric system is solved and inverted in place, without LAPACK."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked, serial


@linked
def decompose(a: Any, n: int) -> bool:
    """Cholesky factor of the leading n x n part of ``a`` in its lower triangle; False where it is not definite."""
    for j in range(n):
        diagonal = a[j, j]
        for k in range(j):
            diagonal -= a[j, k] * a[j, k]
        if not diagonal > 1e-12 * a[j, j] or not diagonal > 0.0:
            return False
        root = np.sqrt(diagonal)
        a[j, j] = root
        for i in range(j + 1, n):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = total / root
    return True


@serial
def solve(factor: Any, b: Any, n: int) -> None:
    """Replace ``b`` by the solution of ``a x = b`` for the factor of :func:`decompose`."""
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= factor[i, k] * b[k]
        b[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * b[k]
        b[i] = total / factor[i, i]


@serial
def add_row(normal: Any, right: Any, row: Any, residual: float, weight: float, n: int) -> None:
    """Add one observation to the lower triangle of the normal equations."""
    for i in range(n):
        scaled = weight * row[i]
        right[i] += scaled * residual
        for j in range(i + 1):
            normal[i, j] += scaled * row[j]
