"""Least squares of mean and phasor from single samples, a tile of pixels at a time.

A sample of a channel with design (a, p, q) whose phase is D ahead of the pixel's obeys
``I = a A + C (p cos D + q sin D) + S (q cos D - p sin D)``: three unknowns, 3 x 3 normal equations, closed form.

``tile`` is a one-dimensional float32 array of :data:`SLOTS` quantities for TILE pixels each; loops over constant
numbers of its elements become vector instructions (see :mod:`pipeline.common.tile_math`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, serial
from pipeline.common.tile_math import TILE

_N, _Q, _RHS = 0, 6, 12  # sums: normal matrix and its covariance (00 01 02 11 12 22), right side
_SUMS = 15
MEAN, RE, IM, VARIANCE = 15, 16, 17, 18  # solution
SLOTS = 19


@serial
def clear(tile: Any) -> None:
    """Set the sums to 0."""
    for j in range(_SUMS * TILE):
        tile[j] = np.float32(0.0)


@inline
def accumulate(tile: Any, j: int, r0: float, r1: float, r2: float, level: float, weight: float, noise: float) -> None:
    """Add a sample ``level`` with design (r0, r1, r2) and variance ``noise`` to the sums of pixel j."""
    w0, w1, w2 = weight * r0, weight * r1, weight * r2
    tile[_RHS * TILE + j] += w0 * level
    tile[(_RHS + 1) * TILE + j] += w1 * level
    tile[(_RHS + 2) * TILE + j] += w2 * level
    tile[_N * TILE + j] += w0 * r0
    tile[(_N + 1) * TILE + j] += w0 * r1
    tile[(_N + 2) * TILE + j] += w0 * r2
    tile[(_N + 3) * TILE + j] += w1 * r1
    tile[(_N + 4) * TILE + j] += w1 * r2
    tile[(_N + 5) * TILE + j] += w2 * r2
    v0, v1, v2 = noise * weight * w0, noise * weight * w1, noise * weight * w2
    tile[_Q * TILE + j] += v0 * r0
    tile[(_Q + 1) * TILE + j] += v0 * r1
    tile[(_Q + 2) * TILE + j] += v0 * r2
    tile[(_Q + 3) * TILE + j] += v1 * r1
    tile[(_Q + 4) * TILE + j] += v1 * r2
    tile[(_Q + 5) * TILE + j] += v2 * r2


@serial
def solve(tile: Any) -> None:
    """Fill MEAN, RE, IM and VARIANCE (of the angle, rad^2); where the samples do not determine them 0, 0, 0 and inf."""
    zero, one, two = np.float32(0.0), np.float32(1.0), np.float32(2.0)
    inf, tiny, share = np.float32(np.inf), np.float32(1e-9), np.float32(1e-3)
    for j in range(TILE):
        n00, n01, n02 = tile[_N * TILE + j], tile[(_N + 1) * TILE + j], tile[(_N + 2) * TILE + j]
        n11, n12, n22 = tile[(_N + 3) * TILE + j], tile[(_N + 4) * TILE + j], tile[(_N + 5) * TILE + j]
        x, y, z = tile[_RHS * TILE + j], tile[(_RHS + 1) * TILE + j], tile[(_RHS + 2) * TILE + j]
        c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
        c11, c12, c22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
        det, scale = n00 * c00 + n01 * c01 + n02 * c02, n00 * n11 * n22
        found = (det > share * scale) & (scale > zero)
        inverse = one / (det if found else one)
        inverse = inverse if found else zero
        tile[MEAN * TILE + j] = (c00 * x + c01 * y + c02 * z) * inverse
        c, s = (c01 * x + c11 * y + c12 * z) * inverse, (c02 * x + c12 * y + c22 * z) * inverse
        tile[RE * TILE + j], tile[IM * TILE + j] = c, s
        y0, y1, y2 = (c02 * c - c01 * s) * inverse, (c12 * c - c11 * s) * inverse, (c22 * c - c12 * s) * inverse
        spread = (
            tile[_Q * TILE + j] * y0 * y0 + tile[(_Q + 3) * TILE + j] * y1 * y1 + tile[(_Q + 5) * TILE + j] * y2 * y2
            + two * (tile[(_Q + 1) * TILE + j] * y0 * y1 + tile[(_Q + 2) * TILE + j] * y0 * y2
                     + tile[(_Q + 4) * TILE + j] * y1 * y2)
        )  # fmt: skip
        norm = c * c + s * s + tiny
        tile[VARIANCE * TILE + j] = spread / (norm * norm) if found else inf
