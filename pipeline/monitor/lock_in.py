"""Lock-in: mean and fringe of every raw channel over a rectangle, at a known phase (compiled).

Every channel is fitted, by least squares over the raw pixels of its own colour, with
``a + a_x x + a_y y + p cos(Phi) + q sin(Phi)``, Phi from the polynomial. No demosaicing, no interpolation; slopes of
the albedo do not leak into p and q. ``p - i q = B exp(i (r + shift))`` yields the phase r by which the light is ahead.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import allocating_linked, linked
from pipeline.monitor.polynomial import solved, waves

LIGHT = 3
"""Numbers of a channel in a patch: a, p, q."""


@linked
def _row_sums(values: Any, cosine: Any, sine: Any, first: int, step: int, n: int, x0: float, d: float, y: float,
              normal: Any, sums: Any) -> None:  # fmt: skip
    """Add a row, or every other pixel of it, to the normal equations of one channel.

    Args:
        values, cosine, sine: (n,) float32; x0 + d j: position of pixel j.
        normal: (15,) lower triangle of the normal matrix of 1, x, y, cos, sin, by rows; sums: (5,) right sides.
    """
    zero, one, start, grow = np.float32(0.0), np.float32(1.0), np.float32(x0), np.float32(d)
    m, mx, mxx, si, sxi, sci, ssi = zero, zero, zero, zero, zero, zero, zero
    sc, ss, sxc, sxs, scc, scs = zero, zero, zero, zero, zero, zero
    for j in range(first, n, step):
        x, c, s, i = start + grow * np.float32(j), cosine[j], sine[j], values[j]
        m += one
        mx += x
        mxx += x * x
        sc += c
        ss += s
        sxc += x * c
        sxs += x * s
        scc += c * c
        scs += c * s
        si += i
        sxi += x * i
        sci += c * i
        ssi += s * i
    normal[0] += m
    normal[1] += mx
    normal[2] += mxx
    normal[3] += y * m
    normal[4] += y * mx
    normal[5] += y * y * m
    normal[6] += sc
    normal[7] += sxc
    normal[8] += y * sc
    normal[9] += scc
    normal[10] += ss
    normal[11] += sxs
    normal[12] += y * ss
    normal[13] += scs
    normal[14] += m - scc
    sums[0] += si
    sums[1] += sxi
    sums[2] += y * si
    sums[3] += sci
    sums[4] += ssi


@allocating_linked
def lock_in(image: Any, mosaic: Any, top: int, left: int, rows: int, columns: int, q: Any, centre_u: float,
             centre_v: float, half_u: float, half_v: float, clip: int, scratch: Any, matrix: Any, right: Any,
             out: Any) -> bool:  # fmt: skip
    """Fit a, p, q of every channel over a rectangle of raw pixels; False when a sample is saturated or a fit singular.

    Every other pair of rows is used (a mosaic repeats after two).

    Args:
        scratch: (5, columns) float32; out: (3, 3) a, p, q by channel, raw counts.
    """
    channels = image.shape[2]
    cosine, sine = scratch[3], scratch[4]
    normal, sums = np.zeros((3, 15)), np.zeros((3, 5))
    d, x0 = 1.0 / half_u, (left - centre_u) / half_u
    largest = 0
    for i in range(rows):
        if i & 2:
            continue
        v = top + i
        y = (v - centre_v) / half_v
        waves(q, half_u, x0, y, columns, cosine, sine)
        for j in range(columns):
            for k in range(channels):
                value = image[v, left + j, k]
                largest = max(largest, value)
                scratch[k, j] = value
        if channels == 3:
            for k in range(3):
                _row_sums(scratch[k], cosine, sine, 0, 1, columns, x0, d, y, normal[k], sums[k])
        else:
            for k in range(2):
                c = mosaic[v & 1, (left + k) & 1]
                _row_sums(scratch[0], cosine, sine, k, 2, columns, x0, d, y, normal[c], sums[c])
    if largest >= clip:
        return False
    for k in range(3):
        for r in range(5):
            right[r, 0] = sums[k, r]
            for s in range(r + 1):
                matrix[r, s] = normal[k, r * (r + 1) // 2 + s]
        if not solved(matrix, right, 5, 1):
            return False
        out[k, 0], out[k, 1], out[k, 2] = right[0, 0], right[3, 0], right[4, 0]
    return True
