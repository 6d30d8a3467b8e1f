"""The equalised phase: each channel divided by its own local mean over about one fringe period.

A coloured surface answers the three fringes unequally, which bends the pointwise phase (half a radian on a coloured
head). Dividing each channel by its mean over one period takes that away; it serves the choice of the fringe order,
where a bias costs, not the sub-pixel match, where it is the same in both cameras and cancels.

The mean is a box over one period x 5 pixels, twice: a triangle in both directions. It is summed up in 16-bit integers,
whole rows of interleaved colours at a time, before black level and crosstalk are taken out; all of them are linear. It
changes so slowly across the rows that three of them share one: :data:`SHARED`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.kernels import serial

_ACROSS = 5  # extent of the box across the direction of growth, pixels
_FULL = 60_000  # largest sum; below 2^16 with room for rounding

SHARED = 3
"""Rows that share the means of the middle one, which is a multiple of this: the rows of the order search."""


@dataclass(frozen=True, slots=True)
class BoxMean:
    """How the double box mean is summed up.

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
    """Index into n elements continued by their mirror image, the border element twice."""
    i = -1 - i if i < 0 else i
    return 2 * n - 1 - i if i >= n else i


@serial
def shared_row(y: int) -> int:
    """The row whose means serve row y."""
    return SHARED * ((y + SHARED // 2) // SHARED)


@serial
def advance(new: Any, old: Any, keep: int, sample: int, column: int, once: Any, oldest: Any, twice: Any) -> None:
    """Let the box over the rows, twice, move on by one row.

    Args:
        new, old: (n,) samples that enter and, when ``keep`` is 1, that leave the first box.
        sample, column: bits dropped of each sample and of the first box.
        once: (n,) uint16, first box; oldest: the first box as it was one extent ago, becomes the present one.
        twice: (n,) uint16, second box.
    """
    drop, half, less, some = sample & 15, (1 << sample) >> 1, column & 15, (1 << column) >> 1
    for j in range(once.shape[0]):
        came, went = np.uint16(np.uint16(new[j] + half) >> drop), np.uint16(np.uint16(old[j] + half) >> drop)
        sums = np.uint16(once[j] + came - keep * went)
        once[j] = sums
        now = np.uint16(np.uint16(sums + some) >> less)
        twice[j] = np.uint16(twice[j] + now - oldest[j])
        oldest[j] = now


@serial
def _add_terms(row: Any, stride: int, digit: int, keep: int, out: Any) -> None:
    """Add to ``out`` (set it, if ``keep`` is 0) one to three elements of a row, one stride apart."""
    one, two = np.uint16(digit >= 2), np.uint16(digit >= 3)
    old = np.uint16(keep)
    second, third = row[one * stride :], row[2 * two * stride :]
    for j in range(out.shape[0]):
        out[j] = np.uint16(old * out[j] + row[j] + one * second[j] + two * third[j])


@serial
def _fourfold(row: Any, stride: int, n: int, out: Any) -> None:
    second, third, fourth = row[stride:], row[2 * stride :], row[3 * stride :]
    for j in range(n):
        out[j] = np.uint16(row[j] + second[j] + third[j] + fourth[j])


@serial
def box_row(row: Any, length: int, work: Any, out: Any) -> None:
    """Sums of ``length`` successive pixels of a row of three interleaved colours: sums of 1, 4, 16 ... put together.

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


@serial
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
    half, drop = (1 << first) >> 1, first & 15
    inner = padded[edge : edge + n]
    for j in range(n):
        inner[j] = np.uint16(np.uint16(twice[j] + half) >> drop)
    for j in range(-(along - 1), 0):
        for k in range(3):
            padded[edge + 3 * j + k] = inner[3 * mirrored(j, width) + k]
            padded[edge + 3 * (width - 1 - j) + k] = inner[3 * mirrored(width - 1 - j, width) + k]
    box_row(padded, along, work, middle)
    if second:
        rounding, shift = np.uint16((1 << second) >> 1), second & 15
        for j in range(middle.shape[0]):
            middle[j] = np.uint16(np.uint16(middle[j] + rounding) >> shift)
    box_row(middle, along, work, out)


@serial
def balance_of_row(means: Any, scale: float, black: Any, unmix: Any, out: Any) -> None:
    """What makes the channels of a row equally bright: one over their means above black, without crosstalk.

    Args:
        means: (3 W,) uint16, colours interleaved; scale: to counts; black: (3,) counts.
        unmix: (3, 3) inverse crosstalk.
        out: (3, W or more) float32, result.
    """
    n = means.shape[0] // 3
    one = np.float32(1.0)
    b0, b1, b2 = black[0], black[1], black[2]
    u00, u01, u02 = unmix[0, 0], unmix[0, 1], unmix[0, 2]
    u10, u11, u12 = unmix[1, 0], unmix[1, 1], unmix[1, 2]
    u20, u21, u22 = unmix[2, 0], unmix[2, 1], unmix[2, 2]
    out0, out1, out2 = out[0, :n], out[1, :n], out[2, :n]
    for j in range(n):
        p = np.float32(means[3 * j]) * scale - b0
        q = np.float32(means[3 * j + 1]) * scale - b1
        r = np.float32(means[3 * j + 2]) * scale - b2
        out0[j] = one / max(u00 * p + u01 * q + u02 * r, one)
        out1[j] = one / max(u10 * p + u11 * q + u12 * r, one)
        out2[j] = one / max(u20 * p + u21 * q + u22 * r, one)


@serial
def equalized_row(levels: Any, balance: Any, unmix: Any, solve: Any, re: Any, im: Any) -> None:
    """Phasor of the balanced channels, about unit size for full modulation.

    Args:
        levels: (3, W or more) float32 counts above black; balance: (3, W or more), of :func:`balance_of_row`.
        unmix: (3, 3) inverse crosstalk; solve: (3, 3), (A, C, S) without crosstalk.
        re, im: (W,) float32, result.
    """
    n = re.shape[0]
    u00, u01, u02 = unmix[0, 0], unmix[0, 1], unmix[0, 2]
    u10, u11, u12 = unmix[1, 0], unmix[1, 1], unmix[1, 2]
    u20, u21, u22 = unmix[2, 0], unmix[2, 1], unmix[2, 2]
    c0, c1, c2 = solve[1, 0], solve[1, 1], solve[1, 2]
    s0, s1, s2 = solve[2, 0], solve[2, 1], solve[2, 2]
    row_x, row_y, row_z = levels[0, :n], levels[1, :n], levels[2, :n]
    by0, by1, by2 = balance[0, :n], balance[1, :n], balance[2, :n]
    for j in range(n):
        x, y, z = row_x[j], row_y[j], row_z[j]
        e0 = (u00 * x + u01 * y + u02 * z) * by0[j]
        e1 = (u10 * x + u11 * y + u12 * z) * by1[j]
        e2 = (u20 * x + u21 * y + u22 * z) * by2[j]
        re[j], im[j] = c0 * e0 + c1 * e1 + c2 * e2, s0 * e0 + s1 * e1 + s2 * e2
