"""Mean of every channel over about one fringe period: a box filter twice, which is a triangle in both directions.

One period x 5 pixels, summed up in 16-bit integers, whole rows of interleaved colours at a time, before black level and
crosstalk are corrected; all of them are linear. The mean changes so slowly across the rows that three of them share
one (:data:`SHARED`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.common.jit import linked, serial

_ACROSS = 5  # extent of the box across the direction of growth, pixels
_FULL = 60_000  # largest sum; below 2^16 with room for rounding

SHARED = 3
"""Rows that share the means of the middle one, which is a multiple of this: the rows of the order search."""


@dataclass(frozen=True, slots=True)
class BoxMean:
    """Extent and fixed-point arithmetic of the double box mean.

    Args:
        along, over: extent of the box along the rows and over the rows, pixels.
        drops: bits dropped of each sample, after the first sum over the rows, before the first sum along them, and
            after that, so that 16 bits hold all sums.
        scale: from the last sum to the mean.
    """

    along: int
    over: int
    drops: tuple[int, int, int, int]
    scale: float

    @staticmethod
    def of(period_px: float, size: tuple[int, int], *, axis: str, largest: int, unit: float = 1.0) -> BoxMean:
        """Box of one period along ``axis`` for samples of 0..``largest`` in ``unit`` counts; size (W, H) in pixels."""
        length = max(3, round(period_px))
        along, over = (length, _ACROSS) if axis == "x" else (_ACROSS, length)
        along, over = min(along, size[0]), min(over, size[1])
        drops, total = [], largest
        for extent in (over, over, along, along):
            drops.append(_excess(total * extent))
            total = (total >> drops[-1]) * extent
        sample, column, first, second = drops
        return BoxMean(along, over, (sample, column, first, second), unit * 2.0 ** sum(drops) / (along * over) ** 2)


def _excess(largest: int) -> int:
    return max(0, (largest // _FULL).bit_length())


@serial
def mirrored(i: int, n: int) -> int:
    """Index into n elements extended by reflection, the border element repeated."""
    i = -1 - i if i < 0 else i
    return 2 * n - 1 - i if i >= n else i


@linked
def shared_row(y: int) -> int:
    """The row whose means are used for row y."""
    return SHARED * ((y + SHARED // 2) // SHARED)


@serial
def advance(new: Any, old: Any, keep: int, sample: int, column: int, once: Any, oldest: Any, twice: Any) -> None:
    """Move the double box over the rows on by one row.

    Args:
        new, old: (n,) samples that enter and, when ``keep`` is 1, that leave the first box.
        sample, column: bits dropped of each sample and of the first box.
        once: (n,) uint16, first box; oldest: the first box as it was one extent ago, becomes the present one.
        twice: (n,) uint16, second box.
    """
    if sample == 0 and column == 0:
        if keep == 1:
            for j in range(once.shape[0]):
                sums = np.uint16(once[j] + new[j] - old[j])
                once[j] = sums
                twice[j] = np.uint16(twice[j] + sums - oldest[j])
                oldest[j] = sums
        else:
            for j in range(once.shape[0]):
                sums = np.uint16(once[j] + new[j])
                once[j] = sums
                twice[j] = np.uint16(twice[j] + sums - oldest[j])
                oldest[j] = sums
        return
    drop, half, column_drop, column_half = sample & 15, (1 << sample) >> 1, column & 15, (1 << column) >> 1
    for j in range(once.shape[0]):
        entering, leaving = np.uint16(np.uint16(new[j] + half) >> drop), np.uint16(np.uint16(old[j] + half) >> drop)
        sums = np.uint16(once[j] + entering - keep * leaving)
        once[j] = sums
        rounded = np.uint16(np.uint16(sums + column_half) >> column_drop)
        twice[j] = np.uint16(twice[j] + rounded - oldest[j])
        oldest[j] = rounded


@serial
def _dropped(row: Any, bits: int, out: Any) -> None:
    """Round away the lowest bits, four at most, of a row (n,) uint16.

    A shift by a compile-time constant takes an eighth of the time of one by a variable.
    """
    n = out.shape[0]
    if bits == 1:
        for j in range(n):
            out[j] = np.uint16(np.uint16(row[j] + 1) >> 1)
    elif bits == 2:
        for j in range(n):
            out[j] = np.uint16(np.uint16(row[j] + 2) >> 2)
    elif bits == 3:
        for j in range(n):
            out[j] = np.uint16(np.uint16(row[j] + 4) >> 3)
    elif bits == 4:
        for j in range(n):
            out[j] = np.uint16(np.uint16(row[j] + 8) >> 4)
    else:
        for j in range(n):
            out[j] = row[j]


@linked
def drop_bits(row: Any, bits: int, out: Any) -> None:
    """Round away the lowest bits of a row (n,) uint16."""
    _dropped(row, min(bits, 4), out)
    for done in range(4, bits, 4):
        _dropped(out, min(bits - done, 4), out)


@linked
def _add_terms(row: Any, stride: int, digit: int, keep: int, out: Any) -> None:
    """Add to ``out`` (set it, if ``keep`` is 0) one to three elements of a row, one stride apart."""
    n = out.shape[0]
    if keep == 0:
        for j in range(n):
            out[j] = row[j]
    else:
        for j in range(n):
            out[j] = np.uint16(out[j] + row[j])
    if digit == 2:
        second = row[stride:]
        for j in range(n):
            out[j] = np.uint16(out[j] + second[j])
    elif digit == 3:
        second, third = row[stride:], row[2 * stride :]
        for j in range(n):
            out[j] = np.uint16(out[j] + second[j] + third[j])


@linked
def _fourfold(row: Any, stride: int, n: int, out: Any) -> None:
    second, third, fourth = row[stride:], row[2 * stride :], row[3 * stride :]
    for j in range(n):
        out[j] = np.uint16(row[j] + second[j] + third[j] + fourth[j])


@linked
def box_row(row: Any, length: int, work: Any, out: Any) -> None:
    """Sums of ``length`` successive pixels of a row of three interleaved colours: composed of sums of 1, 4, 16 ...

    Args:
        row: (3 n,) uint16; work: (2, at least 3 n) uint16, scratch.
        out: (3 n - 3 length + 3,) uint16, the sum from each pixel on.
    """
    power, done, spare = 1, 0, 0
    sums = row
    while power <= length:
        digit = length // power % 4
        if digit:
            _add_terms(sums[3 * done :], 3 * power, digit, 1 if done else 0, out)
            done += digit * power
        if 4 * power <= length:
            wider = work[spare]
            _fourfold(sums, 3 * power, row.shape[0] - 3 * (4 * power - 1), wider)
            sums, spare = wider, 1 - spare
        power *= 4


@linked
def means_of_row(
    twice: Any, along: int, first: int, second: int, padded: Any, middle: Any, work: Any, out: Any
) -> None:
    """Double box along a row of the double box over the rows; mirrored at both ends.

    Args:
        twice: (3 W,) uint16; along, first, second: see :class:`BoxMean`.
        padded: (3 W + 6 along - 6,), middle: (3 W + 3 along - 3,), work: (2, as padded) uint16, scratch.
        out: (3 W,) uint16, result.
    """
    n, edge = twice.shape[0], 3 * (along - 1)
    width = n // 3
    inner = padded[edge : edge + n]
    drop_bits(twice, first, inner)
    for j in range(-(along - 1), 0):
        for k in range(3):
            padded[edge + 3 * j + k] = inner[3 * mirrored(j, width) + k]
            padded[edge + 3 * (width - 1 - j) + k] = inner[3 * mirrored(width - 1 - j, width) + k]
    box_row(padded, along, work, middle)
    # The padded row is no longer needed.
    sums = padded[: middle.shape[0]]
    drop_bits(middle, second, sums)
    box_row(sums, along, work, out)
