"""Exact three-step solution of every pixel of a row of a three-chip image, before any window.

Row kernels: straight loops over contiguous float32 rows without branches, which become vector instructions.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from pipeline.common.jit import linked


@linked
def levels_of_row(raw: Any, scale: float, black: Any, levels: Any) -> None:
    """Counts above black into levels (3, W or more); raw (3 W,), colours interleaved, is multiplied by ``scale``."""
    n = raw.shape[0] // 3
    dark0, dark1, dark2 = black[0], black[1], black[2]
    x, y, z = levels[0, :n], levels[1, :n], levels[2, :n]
    for j in range(n):
        x[j] = np.float32(raw[3 * j]) * scale - dark0
        y[j] = np.float32(raw[3 * j + 1]) * scale - dark1
        z[j] = np.float32(raw[3 * j + 2]) * scale - dark2


@linked
def pointwise_row(
    levels: Any, black: Any, solve: Any, saturation: float, floor: float, gain: float,
    unit_re: Any, unit_im: Any, usable: Any, re: Any, im: Any, mean: Any, tangential: Any,
) -> int:  # fmt: skip
    """Exact three-step solution of one row.

    Args:
        levels: (3, W or more) float32 counts above black; black: (3,) float32 counts.
        solve: (3, 3) float32, levels -> (A, C, S).
        saturation: counts from which a sample is saturated.
        floor, gain: noise model, counts^2 and counts^2 per count.
        unit_re, unit_im: result, (W,) float32, the phasor of size 1.
        usable: result, 1 where no sample is saturated, else 0; where 0, so are the following:
        re, im, mean, tangential: results, C, S, A and the variance of the tangential part of the phasor, counts^2.

    Returns:
        Number of pixels with a saturated sample.
    """
    n = re.shape[0]
    zero, one, tiny = np.float32(0.0), np.float32(1.0), np.float32(1e-12)
    a0, a1, a2 = solve[0, 0], solve[0, 1], solve[0, 2]
    c0, c1, c2 = solve[1, 0], solve[1, 1], solve[1, 2]
    s0, s1, s2 = solve[2, 0], solve[2, 1], solve[2, 2]
    top0, top1, top2 = saturation - black[0], saturation - black[1], saturation - black[2]
    row_x, row_y, row_z = levels[0, :n], levels[1, :n], levels[2, :n]
    saturated = zero
    for j in range(n):
        x, y, z = row_x[j], row_y[j], row_z[j]
        c, s = c0 * x + c1 * y + c2 * z, s0 * x + s1 * y + s2 * z
        inverse = one / np.float32(sqrt(c * c + s * s + tiny))
        u, v = c * inverse, s * inverse
        t0, t1, t2 = s0 * u - c0 * v, s1 * u - c1 * v, s2 * u - c2 * v
        square0, square1, square2 = t0 * t0, t1 * t1, t2 * t2
        photon_noise = square0 * max(x, zero) + square1 * max(y, zero) + square2 * max(z, zero)
        fine = one if (x < top0) & (y < top1) & (z < top2) else zero
        unit_re[j], unit_im[j], usable[j] = u, v, fine
        re[j], im[j] = fine * c, fine * s
        mean[j] = fine * max(a0 * x + a1 * y + a2 * z, zero)
        tangential[j] = fine * (floor * (square0 + square1 + square2) + gain * photon_noise)
        saturated += one - fine
    return int(saturated)
