"""Hole filling: small gaps inside one surface are interpolated, and marked.

A pixel is filled where known pixels enclose it along its row and along its column, both gaps are small, in both the
surface continues from side to side, and both interpolations agree. A gap between two surfaces fails that: across a step
the difference of both sides is not what their slopes predict, and a slit between two surfaces is not enclosed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel

BASE = 3
"""Pixels that a side's slope is taken over, at most; two at least."""
_LIMIT = np.float32(16)
"""Squared difference from the prediction, in variances, up to which a surface continues."""
_NAN, _HALF = np.float32(np.nan), np.float32(0.5)
_YES = np.uint8(1)


@inline
def _side(q: Any, variance: Any, i: int, j: int, down: int, right: int) -> Any:
    """Slope of q per pixel at a known pixel, measured away from the gap, and its variance; NaN without neighbours.

    Args:
        down, right: step away from the gap.
    """
    height, width = q.shape
    base = 0
    for k in range(1, BASE + 1):
        y, x = i + k * down, j + k * right
        if y < 0 or x < 0 or y >= height or x >= width or q[y, x] != q[y, x]:
            break
        base = k
    if base < 2:
        return _NAN, _NAN
    y, x = i + base * down, j + base * right
    per = np.float32(1) / np.float32(base)
    return (q[y, x] - q[i, j]) * per, (variance[y, x] + variance[i, j]) * per * per


@inline
def _steps_to_known(q: Any, i: int, j: int, down: int, right: int, most: int) -> int:
    """Steps to the nearest known pixel in a direction, at most ``most``; 0 where there is none."""
    height, width = q.shape
    for k in range(1, most + 1):
        y, x = i + k * down, j + k * right
        if y < 0 or x < 0 or y >= height or x >= width:
            break
        if q[y, x] == q[y, x]:
            return k
    return 0


@inline
def _across(q: Any, variance: Any, i: int, j: int, down: int, right: int, size: int) -> Any:
    """Interpolation across the gap at an unknown pixel, by a cubic through both sides, and its variance; else NaN.

    Args:
        down, right: direction of the line through the gap; size: pixels of the largest gap.
    """
    back = _steps_to_known(q, i, j, -down, -right, size)
    if back == 0:
        return _NAN, _NAN
    ahead = _steps_to_known(q, i, j, down, right, size + 1 - back)
    if ahead == 0:
        return _NAN, _NAN
    ay, ax, by, bx = i - back * down, j - back * right, i + ahead * down, j + ahead * right
    a_slope, a_noise = _side(q, variance, ay, ax, -down, -right)
    b_slope, b_noise = _side(q, variance, by, bx, down, right)
    a, b, wide = q[ay, ax], q[by, bx], np.float32(back + ahead)
    # Along the line; the first slope was measured against its direction.
    before, after = -a_slope, b_slope
    off = b - a - wide * _HALF * (before + after)
    noise = variance[ay, ax] + variance[by, bx]
    allowed = noise + wide * wide * np.float32(0.25) * (a_noise + b_noise)
    if not off * off <= _LIMIT * allowed:
        return _NAN, _NAN
    t = np.float32(back) / wide
    rest = np.float32(1) - t
    cubic = a * rest * rest * (np.float32(1) + np.float32(2) * t) + b * t * t * (np.float32(3) - np.float32(2) * t)
    cubic += wide * (before * t * rest * rest - after * t * t * rest)
    return cubic, noise * _HALF + wide * wide * (a_noise + b_noise) * (t * rest) ** 2


@parallel
def fill_holes(
    i: int, q: Any, variance: Any, rays: Any, size: int, xyz: Any, sigma: Any, interpolated: Any
) -> None:  # fmt: skip
    """Interpolate the gaps of a row.

    Args:
        q, variance: (H, W) float32, of :func:`pipeline.filter.cloud.surface_tangent.inverse_depth`.
        rays: (H, W, 2) float32, xyz = z (x, y, 1); size: pixels of the largest gap, along rows and along columns.
        xyz: (H, W, 3), sigma: (H, W), float32, changed; interpolated: (H, W) uint8, becomes 1 where filled.
    """
    for j in range(sigma.shape[1]):
        if q[i, j] == q[i, j]:
            continue
        along, along_noise = _across(q, variance, i, j, 0, 1, size)
        if along != along:
            continue
        across, across_noise = _across(q, variance, i, j, 1, 0, size)
        apart = along - across
        if not apart * apart <= _LIMIT * (along_noise + across_noise):
            continue
        inverse = _HALF * (along + across)
        z = np.float32(1) / inverse
        x, y = rays[i, j, 0], rays[i, j, 1]
        xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2] = z * x, z * y, z
        # What both interpolations disagree by is part of the uncertainty of an interpolated point.
        spread = max(along_noise, across_noise) + _HALF * _HALF * apart * apart
        sigma[i, j] = np.sqrt(spread * (x * x + y * y + np.float32(1))) * z * z
        interpolated[i, j] = _YES
