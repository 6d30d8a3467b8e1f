"""Row kernels that apply the correction of :mod:`pipeline.decode.chromatic_phase`."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from pipeline.common.jit import linked

DESIGN_ROWS = 8
"""Rows of a mosaic that share one design; the angles change by less than a thousandth of a radian over them."""


@linked
def correct_phasors(table: Any, step: int, y: int, re: Any, im: Any) -> None:
    """Correct the phasors (W,) of row y; ``table`` and ``step`` of ``ChromaticCorrection``."""
    i = y // step
    g = np.float32((y - i * step) / step)
    f = np.float32(1.0) - g
    t, o = table[i], table[i + 1]
    for j in range(re.shape[0]):
        c, s = re[j], im[j]
        re[j] = (f * t[8, j] + g * o[8, j]) * c + (f * t[9, j] + g * o[9, j]) * s
        im[j] = (f * t[10, j] + g * o[10, j]) * c + (f * t[11, j] + g * o[11, j]) * s


@linked
def correct_means(table: Any, step: int, y: int, re: Any, im: Any, mean: Any) -> None:
    """Correct the means (W,) of row y, before the phasors: the uncorrected ones are needed."""
    i = y // step
    g = np.float32((y - i * step) / step)
    f, zero = np.float32(1.0) - g, np.float32(0.0)
    t, o = table[i], table[i + 1]
    for j in range(mean.shape[0]):
        more = (f * t[6, j] + g * o[6, j]) * re[j] + (f * t[7, j] + g * o[7, j]) * im[j]
        mean[j] = max(mean[j] + more, zero)


@linked
def units_of_row(re: Any, im: Any) -> None:
    """Normalise phasors (W,) to size 1."""
    one, tiny = np.float32(1.0), np.float32(1e-12)
    for j in range(re.shape[0]):
        c, s = re[j], im[j]
        inverse = one / np.float32(sqrt(c * c + s * s + tiny))
        re[j], im[j] = c * inverse, s * inverse


@linked
def corrected_design(mosaic: Any, rows: Any, table: Any, step: int, y: int, out: Any, margin: int) -> None:
    """Corrected design (a, p, q) of every column's colour about row y, in even and odd rows.

    Args:
        out: (6, margin + W or more); ``margin`` is even, and columns beyond the image have the corrections of its ends.
    """
    last = table.shape[2] - 1
    i = y // step
    g = np.float32((y - i * step) / step)
    f = np.float32(1.0) - g
    t, o = table[i], table[i + 1]
    for k in range(6):
        part = k % 3
        for j in range(out.shape[1]):
            color, x = mosaic[k // 3, j & 1], min(max(j - margin, 0), last)
            if part == 0:
                out[k, j] = rows[color, 0]
            else:
                m = part - 1
                out[k, j] = (
                    rows[color, 0] * (f * t[m, x] + g * o[m, x])
                    + rows[color, 1] * (f * t[2 + m, x] + g * o[2 + m, x])
                    + rows[color, 2] * (f * t[4 + m, x] + g * o[4 + m, x])
                )


@linked
def correct_design(table: Any, step: int, y: int, design: Any, margin: int) -> None:
    """Correct the design (3, margin + W or more) of the columns of row y."""
    i = y // step
    g = np.float32((y - i * step) / step)
    f = np.float32(1.0) - g
    t, o = table[i], table[i + 1]
    for j in range(t.shape[1]):
        x = j + margin
        a, p, q = design[0, x], design[1, x], design[2, x]
        for m in range(2):
            design[1 + m, x] = (
                a * (f * t[m, j] + g * o[m, j])
                + p * (f * t[2 + m, j] + g * o[2 + m, j])
                + q * (f * t[4 + m, j] + g * o[4 + m, j])
            )
