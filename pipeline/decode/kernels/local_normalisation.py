"""The normalised phase: each channel divided by its own local mean over about one fringe period.

A coloured surface reflects the three fringes unequally, which biases the pointwise phase (half a radian on a coloured
head). Dividing each channel by its mean over one period removes that; it is used for the fringe order, where a bias
costs, not for the sub-pixel match, where it is the same in both cameras and cancels. The means are those of
:mod:`pipeline.decode.kernels.local_mean`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked


@linked
def balance_of_row(means: Any, scale: float, black: Any, unmix: Any, out: Any) -> None:
    """Factors that make the channels of a row equally bright: one over their means above black, without crosstalk.

    Args:
        means: (3 W,) uint16, colours interleaved; scale: to counts; black: (3,) counts.
        unmix: (3, 3) inverse crosstalk.
        out: (4, W or more) float32, result: the factors, and the mean of the three means.
    """
    n = means.shape[0] // 3
    one, third = np.float32(1.0), np.float32(1 / 3)
    b0, b1, b2 = black[0], black[1], black[2]
    u00, u01, u02 = unmix[0, 0], unmix[0, 1], unmix[0, 2]
    u10, u11, u12 = unmix[1, 0], unmix[1, 1], unmix[1, 2]
    u20, u21, u22 = unmix[2, 0], unmix[2, 1], unmix[2, 2]
    out0, out1, out2, level = out[0, :n], out[1, :n], out[2, :n], out[3, :n]
    for j in range(n):
        p = np.float32(means[3 * j]) * scale - b0
        q = np.float32(means[3 * j + 1]) * scale - b1
        r = np.float32(means[3 * j + 2]) * scale - b2
        x = max(u00 * p + u01 * q + u02 * r, one)
        y = max(u10 * p + u11 * q + u12 * r, one)
        z = max(u20 * p + u21 * q + u22 * r, one)
        out0[j], out1[j], out2[j], level[j] = one / x, one / y, one / z, (x + y + z) * third


@linked
def normalised_row(levels: Any, balance: Any, unmix: Any, solve: Any, re: Any, im: Any, mean: Any) -> None:
    """Phasor of the balanced channels, about unit size for full modulation, and their mean.

    Args:
        levels: (3, W or more) float32 counts above black; balance: (4, W or more), of :func:`balance_of_row`.
        unmix: (3, 3) inverse crosstalk; solve: (3, 3), (A, C, S) without crosstalk.
        re, im, mean: (W,) float32, result; the mean is 1 where the pixel is as bright as its surroundings.
    """
    n = re.shape[0]
    u00, u01, u02 = unmix[0, 0], unmix[0, 1], unmix[0, 2]
    u10, u11, u12 = unmix[1, 0], unmix[1, 1], unmix[1, 2]
    u20, u21, u22 = unmix[2, 0], unmix[2, 1], unmix[2, 2]
    zero = np.float32(0.0)
    a0, a1, a2 = solve[0, 0], solve[0, 1], solve[0, 2]
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
        mean[j] = max(a0 * e0 + a1 * e1 + a2 * e2, zero)


@linked
def brightness_of_row(mean: Any, balance: Any, out: Any) -> None:
    """Brightness of a row, (W,) uint8 counts, from the mean (W,) of its balanced channels.

    Unlike the mean of the channels themselves it does not oscillate with the fringes on a coloured surface.
    """
    half, most = np.float32(0.5), np.float32(255.0)
    level = balance[3, : out.shape[0]]
    for j in range(out.shape[0]):
        out[j] = np.uint8(np.int32(min(mean[j] * level[j] + half, most)))
