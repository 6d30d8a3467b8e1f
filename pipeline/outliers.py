"""What disagrees with its immediate neighbourhood: residuals off their local mean, mixed pixels at borders."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange, serial

RADIUS = 3
"""Half width of the neighbourhood whose mean residual counts, pixels."""

_ROWS = 32
_YES, _NO = np.uint8(1), np.uint8(0)
_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@serial
def _masked(known: Any, value: Any, out: Any) -> None:
    """Values of a row where known, else 0, three further along."""
    into = out[RADIUS:]
    for j in range(known.shape[0]):
        into[j] = value[j] if known[j] != 0 else _ZERO


@serial
def _counted(known: Any, out: Any) -> None:
    into = out[RADIUS:]
    for j in range(known.shape[0]):
        into[j] = _ONE if known[j] != 0 else _ZERO


@serial
def _down(rows: Any, out: Any) -> None:
    a, b, c, d, e, f, g = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6]
    for j in range(out.shape[0]):
        out[j] = ((a[j] + b[j]) + (c[j] + d[j])) + ((e[j] + f[j]) + g[j])


@serial
def _across(x: Any, out: Any) -> None:
    a, b, c, d, e, f, g = x, x[1:], x[2:], x[3:], x[4:], x[5:], x[6:]
    for j in range(out.shape[0]):
        out[j] = ((a[j] + b[j]) + (c[j] + d[j])) + ((e[j] + f[j]) + g[j])


@serial
def _agreeing(
    known: Any, first: Any, second: Any, n: Any, sum1: Any, sum2: Any, wanted: Any, limit: Any, largest: Any, out: Any
) -> None:  # fmt: skip
    for j in range(out.shape[0]):
        near = (abs(first[j] * n[j] - sum1[j]) < limit * n[j]) | (abs(second[j] * n[j] - sum2[j]) < limit * n[j])
        small = (abs(first[j]) <= largest) | (abs(second[j]) <= largest)
        out[j] = known[j] if near & small & (n[j] >= wanted[j]) else _NO


@parallel
def local_outliers(known: Any, first: Any, second: Any, limit: Any, largest: Any, out: Any) -> None:
    """Known pixels with a small residual and one that stays near the mean of its 7 x 7 neighbourhood.

    Args:
        known: (H, W) uint8, 0 or 1.
        first, second: (H, W) float32 residuals, radians.
        limit: float32, largest distance from the mean of the known neighbours, of which there must be a quarter.
        largest: float32, largest residual.
        out: (H, W) uint8, becomes 1 where all is well, else 0.
    """
    height, width = known.shape
    side = 2 * RADIUS + 1
    for block in prange((height + _ROWS - 1) // _ROWS):
        top = block * _ROWS
        bottom = min(top + _ROWS, height)
        # Rows outside the picture and columns beyond its sides stay 0.
        rows1 = np.zeros((_ROWS + side - 1, width + side - 1), np.float32)
        rows2 = np.zeros((_ROWS + side - 1, width + side - 1), np.float32)
        rows_n = np.zeros((_ROWS + side - 1, width + side - 1), np.float32)
        for i in range(max(0, top - RADIUS), min(height, bottom + RADIUS)):
            t = i - top + RADIUS
            _masked(known[i], first[i], rows1[t])
            _masked(known[i], second[i], rows2[t])
            _counted(known[i], rows_n[t])
        column = np.empty(width + side - 1, np.float32)
        n, sum1, sum2 = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        wanted = np.empty(width, np.float32)
        for i in range(top, bottom):
            t = i - top
            _down(rows1[t:], column)
            _across(column, sum1)
            _down(rows2[t:], column)
            _across(column, sum2)
            _down(rows_n[t:], column)
            _across(column, n)
            within = min(height, i + RADIUS + 1) - max(0, i - RADIUS)
            for j in range(width):
                wanted[j] = np.float32(0.25 * within) * np.float32(min(width, j + RADIUS + 1) - max(0, j - RADIUS))
            _agreeing(known[i], first[i], second[i], n, sum1, sum2, wanted, limit, largest, out[i])


@serial
def _modulation_of_surfaces(label: Any, modulation: Any, out: Any) -> None:
    into = out[1:]
    for j in range(label.shape[0]):
        into[j] = modulation[j] if label[j] >= 0 else _NO


@serial
def _largest_of_three(a: Any, b: Any, c: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        x = a[j] if a[j] > b[j] else b[j]
        out[j] = x if x > c[j] else c[j]


@serial
def _weak(label: Any, here: Any, best: Any, share: Any, known: Any, out: Any) -> None:
    for j in range(label.shape[0]):
        known[j] = _YES if label[j] >= 0 else _NO
        out[j] = _YES if (label[j] >= 0) & (np.float32(here[j]) < share * np.float32(best[j])) else _NO


@serial
def _mixed(label: Any, modulation: Any, i: int, j: int, share: Any) -> bool:
    """Whether a pixel lies on its surface's border and is weaker than a share of the best next to it there."""
    height, width = label.shape
    border = i == 0 or j == 0 or i == height - 1 or j == width - 1
    best = 0
    for y in range(max(0, i - 1), min(height, i + 2)):
        for x in range(max(0, j - 1), min(width, j + 2)):
            if label[y, x] == label[i, j]:
                best = max(best, modulation[y, x])
            else:
                border = True
    return border and np.float32(modulation[i, j]) < share * np.float32(best)


@parallel
def drop_mixed_edges(label: Any, modulation: Any, share: Any, known: Any) -> None:
    """Known are the surfaces without border pixels whose modulation falls below a share of that next to them.

    At the border of a surface a pixel that sees only half of it, or half in shadow, mixes two phases.

    Args:
        label: (H, W) int32, surface of each pixel, -1 where there is none.
        modulation: (H, W) uint8; share: float32.
        known: (H, W) uint8, becomes 0 or 1.
    """
    height, width = label.shape
    words = (width + 7) // 8
    for block in prange((height + _ROWS - 1) // _ROWS):
        top = block * _ROWS
        bottom = min(top + _ROWS, height)
        strength = np.zeros((_ROWS + 2, width + 2), np.uint8)
        across = np.zeros((_ROWS + 2, width), np.uint8)
        best = np.empty(width, np.uint8)
        weak = np.zeros(8 * words, np.uint8)
        weak_words = weak.view(np.uint64)
        for i in range(max(0, top - 1), min(height, bottom + 1)):
            row = strength[i - top + 1]
            _modulation_of_surfaces(label[i], modulation[i], row)
            _largest_of_three(row, row[1:], row[2:], across[i - top + 1])
        for i in range(top, bottom):
            t = i - top
            _largest_of_three(across[t], across[t + 1], across[t + 2], best)
            _weak(label[i], strength[t + 1, 1:], best, share, known[i], weak)
            # Few pixels are weak beside any neighbour: only those are looked at closely.
            for word in range(words):
                if weak_words[word] == 0:
                    continue
                for j in range(8 * word, min(8 * word + 8, width)):
                    if weak[j] != 0 and _mixed(label, modulation, i, j, share):
                        known[i, j] = _NO
