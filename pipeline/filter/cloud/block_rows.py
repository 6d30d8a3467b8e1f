"""Values of blocks of n x n pixels as rows: each has the same pixel of BLOCKS blocks, one after the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked, serial

BLOCKS = 64
"""Blocks that are processed together."""
SPACING = BLOCKS + 16
"""Distance of rows; there is room for the blocks before and after."""
LONGEST = 8 * BLOCKS
"""Pixels of a row of so many blocks at most."""
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)


@linked
def _deal_2(values: Any, at: Any, count: int, out: Any, to: Any) -> None:
    """See :func:`deal`."""
    odd = to + np.uint64(SPACING)
    for j in range(count):
        k = np.uint64(j)
        out[to + k], out[odd + k] = values[at + _2 * k], values[at + _2 * k + _1]


@linked
def _deal_4(values: Any, at: Any, count: int, out: Any, to: Any) -> None:
    """See :func:`deal`."""
    b, c, d = to + np.uint64(SPACING), to + np.uint64(2 * SPACING), to + np.uint64(3 * SPACING)
    for j in range(count):
        k = np.uint64(j)
        m = at + np.uint64(4) * k
        out[to + k], out[b + k], out[c + k], out[d + k] = (
            values[m], values[m + _1], values[m + _2], values[m + _3]
        )  # fmt: skip


@linked
def deal(values: Any, at: Any, n: int, count: int, out: Any, to: Any) -> None:
    """Distribute n ``count`` values from number ``at`` on over n rows, SPACING apart, from number ``to`` on.

    Where n is a constant, the compiler shuffles whole vectors.
    """
    if n == 2:
        _deal_2(values, at, count, out, to)
    elif n == 4:
        _deal_4(values, at, count, out, to)
    else:
        for i in range(n):
            for j in range(count):
                out[to + np.uint64(i * SPACING + j)] = values[at + np.uint64(n * j + i)]


@serial
def split(points: Any, at: Any, count: int, out: Any) -> None:
    """Coordinates of pixels from number ``at`` on, to rows of LONGEST values."""
    for j in range(count):
        k = _3 * (at + np.uint64(j))
        out[j], out[LONGEST + j], out[2 * LONGEST + j] = points[k], points[k + _1], points[k + _2]
