"""Surface texture in both cameras, and sums for its displacement in the right one (compiled).

Counts divided by the fitted fringe leave m = sum(I F) / sum(F F) over a 3 x 3 binomial window, in both cameras alike.
The right one is interpolated at the pixel of each left pixel's point; the difference, minus a plane over the patch
(gain and shading), is explained by a displacement (du, dv). The noise of the right gradients correlates with that of
the right brightness, which would bias least squares towards 0: the left gradients, with independent noise, are used as
instruments.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import allocating
from pipeline.monitor.polynomial import quadratic, waves

TEXTURE = 8
"""Sums of a patch: L_u e, L_v e, L_u R_u, L_u R_v, L_v R_u, L_v R_v, e e, L_v L_v."""
EDGE = 2
"""Pixels around a patch for smoothing and gradients."""


@allocating
def brightness(image: Any, mosaic: Any, black: Any, top: int, left: int, rows: int, columns: int, q: Any,
                centre_u: float, centre_v: float, half_u: float, half_v: float, light: Any, scratch: Any,
                raw: Any, out: Any) -> None:  # fmt: skip
    """Counts over the fitted fringe in a rectangle, smoothed; the outermost pixels of ``out`` stay undefined."""
    channels = image.shape[2]
    cosine, sine = scratch[3], scratch[4]
    level, p, r, dark = (
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
    )
    for c in range(3):
        dark[c], level[c], p[c], r[c] = black[c], light[c, 0] - black[c], light[c, 1], light[c, 2]
    for i in range(rows):
        v = top + i
        waves(q, half_u, (left - centre_u) / half_u, (v - centre_v) / half_v, columns, cosine, sine)
        over, under = raw[0, i], raw[1, i]
        if channels == 3:
            for j in range(columns):
                a, b = np.float32(0.0), np.float32(0.0)
                for c in range(3):
                    f = level[c] + p[c] * cosine[j] + r[c] * sine[j]
                    a += f * (np.float32(image[v, left + j, c]) - dark[c])
                    b += f * f
                over[j], under[j] = a, b
        else:
            for j in range(columns):
                c = mosaic[v & 1, (left + j) & 1]
                f = level[c] + p[c] * cosine[j] + r[c] * sine[j]
                over[j], under[j] = f * (np.float32(image[v, left + j, 0]) - dark[c]), f * f
    two, one = np.float32(2.0), np.float32(1.0)
    a, b = scratch[0], scratch[1]
    for i in range(1, rows - 1):
        for j in range(columns):
            a[j] = raw[0, i - 1, j] + two * raw[0, i, j] + raw[0, i + 1, j]
            b[j] = raw[1, i - 1, j] + two * raw[1, i, j] + raw[1, i + 1, j]
        for j in range(1, columns - 1):
            out[i, j] = (a[j - 1] + two * a[j] + a[j + 1]) / max(b[j - 1] + two * b[j] + b[j + 1], one)


@allocating
def compare(left: Any, right: Any, rows: int, columns: int, q: Any, half_u: float, half_v: float, origin_u: float,
             origin_v: float, right_rows: int, right_columns: int, out: Any) -> bool:  # fmt: skip
    """The sums :data:`TEXTURE` of a patch; False when the right rectangle does not contain it.

    Args:
        left, right: brightness, with :data:`EDGE` pixels around the patch; q: (6, 3), columns 1 and 2 the right pixel.
    """
    plane, products = np.zeros((3, 5)), np.zeros(TEXTURE)
    f = np.empty(5)
    sx, sy, middle = 0.0, 0.0, (columns - 1) // 2
    for i in range(rows):
        y = (i - 0.5 * (rows - 1)) / half_v
        for j in range(1, columns - 1, 2):
            x = (j - 0.5 * (columns - 1)) / half_u
            ur = quadratic(q, 1, x, y) - origin_u
            vr = quadratic(q, 2, x, y) - origin_v
            a, b = int(np.floor(vr)), int(np.floor(ur))
            if a < 2 or b < 2 or a > right_rows - 4 or b > right_columns - 4:
                return False
            fv, fu = vr - a, ur - b
            w00, w01, w10, w11 = (1 - fv) * (1 - fu), (1 - fv) * fu, fv * (1 - fu), fv * fu
            value = w00 * right[a, b] + w01 * right[a, b + 1] + w10 * right[a + 1, b] + w11 * right[a + 1, b + 1]
            ru = 0.5 * (
                w00 * (right[a, b + 1] - right[a, b - 1]) + w01 * (right[a, b + 2] - right[a, b])
                + w10 * (right[a + 1, b + 1] - right[a + 1, b - 1]) + w11 * (right[a + 1, b + 2] - right[a + 1, b])
            )  # fmt: skip
            rv = 0.5 * (
                w00 * (right[a + 1, b] - right[a - 1, b]) + w01 * (right[a + 1, b + 1] - right[a - 1, b + 1])
                + w10 * (right[a + 2, b] - right[a, b]) + w11 * (right[a + 2, b + 1] - right[a, b + 1])
            )  # fmt: skip
            k, m = i + EDGE, j + EDGE
            f[0] = left[k, m] - value
            f[1], f[2] = 0.5 * (left[k, m + 1] - left[k, m - 1]), 0.5 * (left[k + 1, m] - left[k - 1, m])
            f[3], f[4] = ru, rv
            across, down = float(j - middle), i - 0.5 * (rows - 1)
            sx += across * across
            sy += down * down
            for c in range(5):
                plane[0, c] += f[c]
                plane[1, c] += across * f[c]
                plane[2, c] += down * f[c]
            products[0] += f[1] * f[0]
            products[1] += f[2] * f[0]
            products[2] += f[1] * f[3]
            products[3] += f[1] * f[4]
            products[4] += f[2] * f[3]
            products[5] += f[2] * f[4]
            products[6] += f[0] * f[0]
            products[7] += f[2] * f[2]
    n = rows * ((columns - 1) // 2)
    pairs = ((1, 0), (2, 0), (1, 3), (1, 4), (2, 3), (2, 4), (0, 0), (2, 2))
    for k in range(TEXTURE):
        c, d = pairs[k]
        # On a rectangle 1, x and y are orthogonal.
        out[k] = products[k] - (
            plane[0, c] * plane[0, d] / n + plane[1, c] * plane[1, d] / sx + plane[2, c] * plane[2, d] / sy
        )
    return True
