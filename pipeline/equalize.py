"""The equalised phase: each channel divided by its own local mean over about one fringe period.

A coloured surface answers the three fringes unequally, which bends the pointwise phase (half a radian on a coloured
head). Dividing each channel by its mean over one period takes that away; it serves the choice of the fringe order,
where a bias costs, not the sub-pixel match, where it is the same in both cameras and cancels.

The mean is a box over one period x 5 pixels, twice: a triangle in both directions. It is summed up in integers, whole
rows of interleaved colours at a time, before black level and crosstalk are taken out; all of them are linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.kernels import serial

_ACROSS = 5  # extent of the box across the direction of growth, pixels
_FULL = 60_000  # largest sum along a row; below 2^16 with room for rounding


@dataclass(frozen=True, slots=True)
class BoxMean:
    """How the double box mean is summed up.

    Args:
        along, over: extent of the box along the rows and over the rows, pixels.
        drops: bits dropped before the first sum along the rows, and after it, so that 16 bits hold the sums.
        scale: from the last sum to the mean.
    """

    along: int
    over: int
    drops: tuple[int, int]
    scale: float

    @staticmethod
    def of(period_px: float, size: tuple[int, int], *, axis: str, largest: int, unit: float = 1.0) -> BoxMean:
        """Box of one period along ``axis`` for samples of 0..``largest`` in ``unit`` counts; size (W, H) in pixels."""
        length = max(3, round(period_px))
        along, over = (length, _ACROSS) if axis == "x" else (_ACROSS, length)
        along, over = min(along, size[0]), min(over, size[1])
        total = largest * over**2
        first = _excess(total * along)
        total = (total * along) >> first
        second = _excess(total * along)
        return BoxMean(along, over, (first, second), unit * 2.0 ** (first + second) / (along * over) ** 2)


def _excess(largest: int) -> int:
    return max(0, (largest // _FULL).bit_length())


@serial
def mirrored(i: int, n: int) -> int:
    """Index into n elements continued by their mirror image, the border element twice."""
    i = -1 - i if i < 0 else i
    return 2 * n - 1 - i if i >= n else i


@serial
def advance(new: Any, old: Any, keep: int, once: Any, oldest: Any, twice: Any) -> None:
    """Let the box over the rows, twice, move on by one row.

    Args:
        new, old: (n,) samples that enter and, when ``keep`` is 1, that leave the first box.
        once: (n,) int32, first box; oldest: the first box as it was one extent ago, becomes the present one.
        twice: (n,) int32, second box.
    """
    for j in range(once.shape[0]):
        sums = np.int32(once[j] + np.int32(new[j]) - keep * np.int32(old[j]))
        once[j] = sums
        twice[j] += np.int32(sums - oldest[j])
        oldest[j] = sums


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
        twice: (3 W,) int32; along, first, second: see :class:`BoxMean`.
        padded: (3 W + 6 along - 6,), middle: (3 W + 3 along - 3,), work: (2, as padded) uint16, scratch.
        out: (3 W,) uint16, result.
    """
    n, edge = twice.shape[0], 3 * (along - 1)
    width = n // 3
    share, half = np.float32(1.0 / (1 << first)), np.float32(0.5)
    inner = padded[edge : edge + n]
    for j in range(n):
        inner[j] = np.uint16(np.int32(np.float32(twice[j]) * share + half))
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
def equalized_row(levels: Any, means: Any, scale: float, black: Any, unmix: Any, solve: Any, re: Any, im: Any) -> None:
    """Phasor of the channels divided by their means, about unit size for full modulation.

    Args:
        levels: (3, W) float32 counts above black; means: (3 W,) uint16, colours interleaved; scale: to counts.
        black: (3,) counts; unmix: (3, 3) inverse crosstalk; solve: (3, 3), (A, C, S) without crosstalk.
        re, im: (W,) float32, result.
    """
    n = re.shape[0]
    one = np.float32(1.0)
    b0, b1, b2 = black[0], black[1], black[2]
    u00, u01, u02 = unmix[0, 0], unmix[0, 1], unmix[0, 2]
    u10, u11, u12 = unmix[1, 0], unmix[1, 1], unmix[1, 2]
    u20, u21, u22 = unmix[2, 0], unmix[2, 1], unmix[2, 2]
    c0, c1, c2 = solve[1, 0], solve[1, 1], solve[1, 2]
    s0, s1, s2 = solve[2, 0], solve[2, 1], solve[2, 2]
    row_x, row_y, row_z = levels[0, :n], levels[1, :n], levels[2, :n]
    for j in range(n):
        x, y, z = row_x[j], row_y[j], row_z[j]
        p = np.float32(means[3 * j]) * scale - b0
        q = np.float32(means[3 * j + 1]) * scale - b1
        r = np.float32(means[3 * j + 2]) * scale - b2
        d0 = max(u00 * p + u01 * q + u02 * r, one)
        d1 = max(u10 * p + u11 * q + u12 * r, one)
        d2 = max(u20 * p + u21 * q + u22 * r, one)
        # One division for all three: each numerator times the other two denominators.
        inverse = one / (d0 * d1 * d2)
        e0 = (u00 * x + u01 * y + u02 * z) * d1 * d2 * inverse
        e1 = (u10 * x + u11 * y + u12 * z) * d0 * d2 * inverse
        e2 = (u20 * x + u21 * y + u22 * z) * d0 * d1 * inverse
        re[j], im[j] = c0 * e0 + c1 * e1 + c2 * e2, s0 * e0 + s1 * e1 + s2 * e2
