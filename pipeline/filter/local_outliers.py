"""What disagrees locally: residuals off their local mean, local means off zero, mixed pixels at borders."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked, serial
from pipeline.common.median import median
from pipeline.common.parallel_for import parallel_allocating
from pipeline.match.match_result import MatchResult

RADIUS = 3
"""Half width of the neighbourhood whose mean residual counts, pixels."""

ROWS = 32
MOST_MEAN = 300
"""Steps; sums over a neighbourhood stay within 16 bits."""
_SAMPLES = 800
_YES, _NO = np.uint8(1), np.uint8(0)


@linked
def _shift(came: Any, came_known: Any, gone: Any, gone_known: Any, total: Any) -> None:
    """Column sums of valid values after a row came and another went; they start three pixels left of the row."""
    into = total[RADIUS:]
    for j in range(came.shape[0]):
        a, b = came[j], gone[j]
        a, b = a if came_known[j] != 0 else np.int16(0), b if gone_known[j] != 0 else np.int16(0)
        into[j] += np.int16(a - b)


@linked
def _shift_count(came_known: Any, gone_known: Any, total: Any) -> None:
    into = total[RADIUS:]
    for j in range(came_known.shape[0]):
        into[j] += np.int16(came_known[j]) - np.int16(gone_known[j])


@serial
def _across(x: Any, out: Any) -> None:
    a, b, c, d, e, f, g = x, x[1:], x[2:], x[3:], x[4:], x[5:], x[6:]
    for j in range(out.shape[0]):
        out[j] = ((a[j] + b[j]) + (c[j] + d[j])) + ((e[j] + f[j]) + g[j])


@linked
def _agreeing(
    valid: Any, first: Any, second: Any, n: Any, sum1: Any, sum2: Any, window: Any, limit: int, largest: int,
    mean: int, out: Any,
) -> None:  # fmt: skip
    """See :func:`local_outliers`; everything fits into 16 bits, without sign where differences are concerned."""
    for j in range(out.shape[0]):
        a, b = np.int16(first[j] * n[j]), np.int16(second[j] * n[j])
        from1 = np.uint16(a - sum1[j]) if a > sum1[j] else np.uint16(sum1[j] - a)
        from2 = np.uint16(b - sum2[j]) if b > sum2[j] else np.uint16(sum2[j] - b)
        most = np.uint16(limit * n[j])
        near = (from1 < most) | (from2 < most)
        small = np.uint16(first[j] + largest) <= np.uint16(2 * largest)
        small |= np.uint16(second[j] + largest) <= np.uint16(2 * largest)
        far = np.uint16(mean * n[j])
        small &= (np.uint16(sum1[j] + far) <= np.uint16(2 * far)) | (np.uint16(sum2[j] + far) <= np.uint16(2 * far))
        here = valid[j]
        out[j] = here if near & small & (np.uint16(4 * n[j]) >= np.uint16(window[j])) else _NO


@parallel_allocating
def local_outliers(
    band: int, valid: Any, first: Any, second: Any, limit: int, largest: int, mean: int, out: Any
) -> None:
    """Known pixels with a small residual and one that stays near the mean of its 7 x 7 neighbourhood.

    Where that mean itself is far from zero, a whole strip is matched to another surface whose phase happens to agree.

    Args:
        valid: (H, W) uint8, 0 or 1.
        first, second: (H, W) int16 residuals, up to 668 steps where valid.
        limit: steps that a residual stays below from the mean of the valid neighbours, which must be a quarter of all.
        largest: steps, largest residual; both up to 668.
        mean: steps, largest mean of the smaller of both residuals, up to :data:`MOST_MEAN`.
        out: (H, W) uint8, becomes 1 where all is well, else 0.
    """
    height, width = valid.shape
    top = band * ROWS
    bottom = min(top + ROWS, height)
    # Columns beyond the image's sides stay 0, and rows above and below it count as unknown.
    column1, column2, column_n = (np.zeros(width + 2 * RADIUS, np.int16), np.zeros(width + 2 * RADIUS, np.int16),
                                  np.zeros(width + 2 * RADIUS, np.int16))  # fmt: skip
    n, sum1, sum2 = np.empty(width, np.int16), np.empty(width, np.int16), np.empty(width, np.int16)
    window, columns = np.empty(width, np.int16), np.empty(width, np.int16)
    for j in range(width):
        columns[j] = min(width, j + RADIUS + 1) - max(0, j - RADIUS)
    nothing = np.zeros(width, np.uint8)
    first_row = max(0, top - RADIUS)
    for i in range(first_row, bottom + RADIUS):
        old = i - 2 * RADIUS - 1
        came, gone = min(i, height - 1), max(old, 0)
        came_known = valid[came] if i < height else nothing
        gone_known = valid[gone] if old >= first_row else nothing
        _shift(first[came], came_known, first[gone], gone_known, column1)
        _shift(second[came], came_known, second[gone], gone_known, column2)
        _shift_count(came_known, gone_known, column_n)
        middle = i - RADIUS
        if middle < top:
            continue
        _across(column1, sum1)
        _across(column2, sum2)
        _across(column_n, n)
        within = min(height, middle + RADIUS + 1) - max(0, middle - RADIUS)
        for j in range(width):
            window[j] = within * columns[j]
        _agreeing(
            valid[middle], first[middle], second[middle], n, sum1, sum2, window, limit, largest, mean, out[middle]
        )


@serial
def _usual_residuals(valid: Any, first: Any, second: Any, step: int, means: Any, squares: Any) -> int:
    """Of every n-th neighbourhood without an unknown pixel: absolute mean and mean square of the smaller residual.

    Returns their number.
    """
    size, n = 2 * RADIUS + 1, 0
    for top in range(0, valid.shape[0] - size + 1, step):
        for left in range(0, valid.shape[1] - size + 1, step):
            known, sum1, sum2, square = True, np.int64(0), np.int64(0), np.int64(0)
            for i in range(top, top + size):
                for j in range(left, left + size):
                    known &= valid[i, j] != 0
                    a, b = np.int64(first[i, j]), np.int64(second[i, j])
                    sum1, sum2, square = sum1 + a, sum2 + b, square + min(a * a, b * b)
            if known:
                means[n], squares[n] = min(abs(sum1), abs(sum2)) / size**2, square / size**2
                n += 1
    return n


def usual_residuals(match: MatchResult) -> tuple[int, int]:
    """Medians over the image of mean and mean square of the smaller residual around a pixel, steps; 0 without any."""
    step = max(1, round((match.valid.size / _SAMPLES) ** 0.5))
    means, squares = np.empty((2, (match.valid.shape[0] // step + 1) * (match.valid.shape[1] // step + 1)))
    n = _usual_residuals(match.valid, match.residual_normalised, match.residual, step, means, squares)
    return (int(median(means[:n])), int(median(squares[:n]))) if n else (0, 0)


@linked
def _pad(label: Any, modulation: Any, labels: Any, strengths: Any, out: Any) -> None:
    """Label and modulation (0 where there is no surface) one further along, and whether there is a surface."""
    a, b = labels[1:], strengths[1:]
    for j in range(label.shape[0]):
        a[j] = label[j]
    for j in range(label.shape[0]):
        strength = modulation[j]
        b[j] = strength if label[j] != 0 else _NO
        out[j] = _YES if label[j] != 0 else _NO


@linked
def _largest_of_three(a: Any, b: Any, c: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        x = a[j] if a[j] > b[j] else b[j]
        out[j] = x if x > c[j] else c[j]


@linked
def _least_of_three(a: Any, b: Any, c: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        x = a[j] if a[j] < b[j] else b[j]
        out[j] = x if x < c[j] else c[j]


@linked
def _perhaps_mixed(here: Any, best: Any, share: int, first: Any, last: Any, out: Any) -> None:
    """1 where several surfaces, or none, are near and a strength may fall below so many 256ths of the best."""
    for j in range(out.shape[0]):
        weak = np.uint16(here[j] << 8) < np.uint16(best[j] * share)
        out[j] = _YES if weak & (first[j] != last[j]) else _NO


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


@parallel_allocating
def drop_mixed_edges(band: int, label: Any, modulation: Any, share: Any, out: Any) -> None:
    """Surfaces without the pixels at their border whose modulation falls below a share of that next to them.

    At the border of a surface a pixel that sees only half of it, or half in shadow, mixes two phases.

    Args:
        label: (H, W) uint16, of :meth:`pipeline.filter.surfaces.connected_components.Surfaces.paint`.
        modulation: (H, W) uint8; share: float32, up to 1.
        out: (H, W) uint8, becomes 1 where a pixel of a surface stays, else 0.
    """
    height, width = label.shape
    blocks = (width + 7) // 8
    share_256 = min(int(share * np.float32(256.0)) + 1, 256)
    top = band * ROWS
    bottom = min(top + ROWS, height)
    # Beyond the image there is no surface. Rows are kept in turns of three.
    strength, labels = np.zeros((3, width + 2), np.uint8), np.zeros((3, width + 2), np.uint16)
    best_of_row = np.zeros((3, width), np.uint8)
    least_of_row, most_of_row = np.zeros((3, width), np.uint16), np.zeros((3, width), np.uint16)
    best, least, most = np.empty(width, np.uint8), np.empty(width, np.uint16), np.empty(width, np.uint16)
    doubtful, ignored = np.zeros(8 * blocks, np.uint8), np.empty(width, np.uint8)
    doubtful_blocks = doubtful.view(np.uint64)
    for i in range(max(0, top - 1), bottom + 1):
        now = i % 3
        s, k = strength[now], labels[now]
        if i < height:
            _pad(label[i], modulation[i], k, s, out[i] if top <= i < bottom else ignored)
        else:
            s[:], k[:] = _NO, 0
        _largest_of_three(s, s[1:], s[2:], best_of_row[now])
        _least_of_three(k, k[1:], k[2:], least_of_row[now])
        _largest_of_three(k, k[1:], k[2:], most_of_row[now])
        here = i - 1
        if here < top:
            continue
        _largest_of_three(best_of_row[0], best_of_row[1], best_of_row[2], best)
        _least_of_three(least_of_row[0], least_of_row[1], least_of_row[2], least)
        _largest_of_three(most_of_row[0], most_of_row[1], most_of_row[2], most)
        _perhaps_mixed(strength[here % 3, 1:], best, share_256, least, most, doubtful[:width])
        # Few pixels are doubtful: only those are tested in full.
        for eight in range(blocks):
            if doubtful_blocks[eight] == 0:
                continue
            for j in range(8 * eight, 8 * eight + 8):
                if doubtful[j] != 0 and label[here, j] != 0 and _mixed(label, modulation, here, j, share):
                    out[here, j] = _NO
