"""Gains of the channels on strongly coloured surfaces, before the pointwise phase is computed.

Unequal channels add to the phasor of the fringes, of size B / 2 times the sum of the channels' reflectances, a constant
one of A times their vector sum. Of a mild colour the bias is the same in both cameras and cancels in the match, and
gains would only add noise and the errors of the local means. Of a strong one (yellow, orange, blue) both are about as
large: the phasor passes by 0 once a period, where its phase is noise, and turns unevenly or not at all. There every
channel is divided by its local mean, as for the normalised phase.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import linked

MILD, STRONG = 0.45, 0.52
"""Vector sum of the channels' means over half of their sum, up to which a colour is left as it is and from which its
channels become equal."""
WIDEST_PX = 30.0
"""Period of the fringes from which no gains are used: an error of the local means, which mix the colours of a larger
area, displaces points by millimetres there."""
LARGEST_GAIN = 16.0
BLOCK = 64
"""Pixels of a row whose gains are computed together, if one of them is strongly coloured."""
LAG = 4
"""Pixels to either side between which the change of the gains is taken."""
CHANGE = 0.5
"""Variance of the phase before the window over the squared relative change of the gains."""


def limits_of(period_px: float) -> NDArray[np.float32]:
    """For :func:`gains_of_row`: the square of the limit of mild colours, and one over its distance to the other's."""
    if period_px > WIDEST_PX:
        return np.array([1e9, 1.0], np.float32)
    return np.array([MILD**2, 1 / (STRONG**2 - MILD**2)], np.float32)


@linked
def _flag_colored(balance: Any, limits: Any, flags: Any) -> None:
    """1 at pixels (W,) whose channels differ by more than those of a mild colour, else 0."""
    four, mild = np.float32(4.0), limits[0]
    n = flags.shape[0]
    by0, by1, by2 = balance[0, :n], balance[1, :n], balance[2, :n]
    for j in range(n):
        # Proportional to the means, without a division.
        x, y, z = by1[j] * by2[j], by0[j] * by2[j], by0[j] * by1[j]
        total = x + y + z
        flags[j] = four * (x * x + y * y + z * z - x * y - y * z - z * x) > mild * total * total


@linked
def _gains(balance: Any, limits: Any, start: int, end: int, out: Any) -> None:
    """Gains of successive pixels of a row.

    Rows are cut here, of whole arrays: of one that is cut along its rows the compiler does not know that the numbers of
    a row lie side by side, and gathers them.
    """
    zero, one, most = np.float32(0.0), np.float32(1.0), np.float32(LARGEST_GAIN)
    third, four = np.float32(1 / 3), np.float32(4.0)
    mild, slope = limits[0], limits[1]
    by0, by1, by2 = balance[0, start:end], balance[1, start:end], balance[2, start:end]
    out0, out1, out2 = out[0, start:end], out[1, start:end], out[2, start:end]
    for j in range(out0.shape[0]):
        x, y, z = by1[j] * by2[j], by0[j] * by2[j], by0[j] * by1[j]
        total = x + y + z
        vector_sq = x * x + y * y + z * z - x * y - y * z - z * x
        share = (four * vector_sq / (total * total) - mild) * slope
        share = min(max(share, zero), one)
        level = total * third
        out0[j] = min(one + share * (level / x - one), most)
        out1[j] = min(one + share * (level / y - one), most)
        out2[j] = min(one + share * (level / z - one), most)


@linked
def gains_of_row(balance: Any, limits: Any, width: int, flags: Any, runs: Any, n_runs: int, out: Any) -> int:
    """Gains of the unmixed channels, whose mean brightness they keep; exactly 1 on surfaces that are mildly coloured.

    Args:
        balance: (3, W or more), of :func:`pipeline.decode.kernels.local_normalisation.balance_of_row`.
        limits: (2,), of :func:`limits_of`.
        flags: (16 + a multiple of BLOCK from W on,) uint8, scratch, 0 but for what this function left there.
        runs: (n, 2) int32, first pixel and end of the parts of the row with gains, and their surroundings; those of the
            last row, ``n_runs``, are replaced.
        out: (3, W or more) float32, result; before the first row 1.

    Returns:
        Number of runs.
    """
    one = np.float32(1.0)
    for r in range(n_runs):
        for k in range(3):
            for j in range(runs[r, 0], runs[r, 1]):
                out[k, j] = one
    _flag_colored(balance, limits, flags[8 : 8 + width])
    eights = flags.view(np.uint64)
    n, opened = 0, False
    for first in range(0, width, BLOCK):
        found = np.uint64(0)
        for word in range(first // 8, first // 8 + BLOCK // 8 + 2):  # with eight pixels before and after the block
            found |= eights[word]
        if found != 0:
            n += 0 if opened else 1
            runs[n - 1, 0] = runs[n - 1, 0] if opened else first
            runs[n - 1, 1] = min(first + BLOCK, width)
        opened = found != 0
    for r in range(n):
        start, end = runs[r, 0], runs[r, 1]
        _gains(balance, limits, start, end, out)
    return n


@linked
def balanced_row(
    levels: Any, gains: Any, start: int, unmix: Any, ideal: Any, floor: float, gain: float, unit_re: Any, unit_im: Any,
    usable: Any, re: Any, im: Any, mean: Any, tangential: Any,
) -> None:  # fmt: skip
    """Replace the results of :func:`pipeline.decode.kernels.three_step.pointwise_row` where there are gains.

    Args:
        levels: (3, W or more) float32 counts above black; gains: (3, W or more), of :func:`gains_of_row`; ``start``:
            their column of the first pixel, which is the first of all other rows.
        unmix: (3, 3) inverse crosstalk; ideal: (3, 3), (A, C, S) without crosstalk; the rest as of that function.
    """
    zero, one, tiny = np.float32(0.0), np.float32(1.0), np.float32(1e-12)
    n = re.shape[0]
    a0, a1, a2 = ideal[0, 0], ideal[0, 1], ideal[0, 2]
    c0, c1, c2 = ideal[1, 0], ideal[1, 1], ideal[1, 2]
    s0, s1, s2 = ideal[2, 0], ideal[2, 1], ideal[2, 2]
    u00, u01, u02 = unmix[0, 0], unmix[0, 1], unmix[0, 2]
    u10, u11, u12 = unmix[1, 0], unmix[1, 1], unmix[1, 2]
    u20, u21, u22 = unmix[2, 0], unmix[2, 1], unmix[2, 2]
    end = start + n
    row_x, row_y, row_z = levels[0, start:end], levels[1, start:end], levels[2, start:end]
    gain0, gain1, gain2 = gains[0, start:end], gains[1, start:end], gains[2, start:end]
    for j in range(n):
        x, y, z = row_x[j], row_y[j], row_z[j]
        g0, g1, g2 = gain0[j], gain1[j], gain2[j]
        e0 = (u00 * x + u01 * y + u02 * z) * g0
        e1 = (u10 * x + u11 * y + u12 * z) * g1
        e2 = (u20 * x + u21 * y + u22 * z) * g2
        c, s = c0 * e0 + c1 * e1 + c2 * e2, s0 * e0 + s1 * e1 + s2 * e2
        inverse = one / np.float32(sqrt(c * c + s * s + tiny))
        u, v = c * inverse, s * inverse
        w0, w1, w2 = (s0 * u - c0 * v) * g0, (s1 * u - c1 * v) * g1, (s2 * u - c2 * v) * g2
        t0, t1, t2 = w0 * u00 + w1 * u10 + w2 * u20, w0 * u01 + w1 * u11 + w2 * u21, w0 * u02 + w1 * u12 + w2 * u22
        square0, square1, square2 = t0 * t0, t1 * t1, t2 * t2
        photon_noise = square0 * max(x, zero) + square1 * max(y, zero) + square2 * max(z, zero)
        fine = usable[j]
        same = (g0 == one) & (g1 == one) & (g2 == one)
        unit_re[j], unit_im[j] = (unit_re[j] if same else u), (unit_im[j] if same else v)
        re[j], im[j] = (re[j] if same else fine * c), (im[j] if same else fine * s)
        mean[j] = mean[j] if same else fine * max(a0 * e0 + a1 * e1 + a2 * e2, zero)
        noise = fine * (floor * (square0 + square1 + square2) + gain * photon_noise)
        tangential[j] = tangential[j] if same else noise


@linked
def widen_at_changes(gains: Any, start: int, end: int, re: Any, im: Any, tangential: Any) -> None:
    """Add to the variances of a run of pixels of a row (W,) what a change of the gains (3, W) around them adds."""
    low, high = max(start, LAG), min(end, re.shape[0] - LAG)
    if high <= low:
        return
    factor = np.float32(CHANGE)
    c, s, variance = re[low:high], im[low:high], tangential[low:high]
    for k in range(3):
        here, behind, ahead = gains[k, low:high], gains[k, low - LAG : high - LAG], gains[k, low + LAG : high + LAG]
        for j in range(variance.shape[0]):
            change = (ahead[j] - behind[j]) / here[j]
            variance[j] += factor * change * change * (c[j] * c[j] + s[j] * s[j])


@linked
def balanced_units(levels: Any, gains: Any, start: int, unmix: Any, ideal: Any, re: Any, im: Any, mean: Any) -> None:
    """Unit phasors and mean (W,) of levels with gains; arguments as of :func:`balanced_row`."""
    zero, one, tiny = np.float32(0.0), np.float32(1.0), np.float32(1e-12)
    n = re.shape[0]
    end = start + n
    row_x, row_y, row_z = levels[0, start:end], levels[1, start:end], levels[2, start:end]
    gain0, gain1, gain2 = gains[0, start:end], gains[1, start:end], gains[2, start:end]
    for j in range(n):
        x, y, z = row_x[j], row_y[j], row_z[j]
        e0 = (unmix[0, 0] * x + unmix[0, 1] * y + unmix[0, 2] * z) * gain0[j]
        e1 = (unmix[1, 0] * x + unmix[1, 1] * y + unmix[1, 2] * z) * gain1[j]
        e2 = (unmix[2, 0] * x + unmix[2, 1] * y + unmix[2, 2] * z) * gain2[j]
        c = ideal[1, 0] * e0 + ideal[1, 1] * e1 + ideal[1, 2] * e2
        s = ideal[2, 0] * e0 + ideal[2, 1] * e1 + ideal[2, 2] * e2
        inverse = one / np.float32(sqrt(c * c + s * s + tiny))
        re[j], im[j] = c * inverse, s * inverse
        mean[j] = max(ideal[0, 0] * e0 + ideal[0, 1] * e1 + ideal[0, 2] * e2, zero)


@linked
def design_of(mix: Any, light: Any, gains: Any, channel: int, j: int) -> tuple[Any, Any, Any]:
    """Design (a, p, q) of a camera channel at pixel j with gains (3, W): the surface reflects one over them.

    Args:
        mix: (3, 3) crosstalk; light: (3, 3) of the projector's channels, (1, cos, -sin) of their shifts.
    """
    m0, m1, m2 = mix[channel, 0] / gains[0, j], mix[channel, 1] / gains[1, j], mix[channel, 2] / gains[2, j]
    return (
        m0 * light[0, 0] + m1 * light[1, 0] + m2 * light[2, 0],
        m0 * light[0, 1] + m1 * light[1, 1] + m2 * light[2, 1],
        m0 * light[0, 2] + m1 * light[1, 2] + m2 * light[2, 2],
    )


@linked
def design_of_row(
    even: int, odd: int, mix: Any, light: Any, gains: Any, start: int, end: int, out: Any, margin: int
) -> None:
    """Design of some columns of a row of a mosaic, out (3, margin + W or more); even, odd: channels of its columns."""
    for j in range(start, end):
        x = j + margin
        out[0, x], out[1, x], out[2, x] = design_of(mix, light, gains, odd if j & 1 else even, j)
