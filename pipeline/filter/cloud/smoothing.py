"""Smoothing along the surface: a weighted plane fit around every point, over neighbours on its tangent plane only.

Steps stay sharp, as points beyond them are not on the plane; planes of any tilt, and their borders, are not displaced,
as the fit has a slope. Every point stays on its viewing ray.
"""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import parallel
from pipeline.filter.cloud.surface_tangent import on_plane, tangent

_ONE = np.float32(1)
_LEAST = np.float32(1e-6)
"""Determinant of a fit, over the product of its diagonal, below which only the mean is taken."""


def kernel(sigma_px: float) -> NDArray[np.float32]:
    """Gaussian weights (2 r + 1, 2 r + 1), r = 2 sigma rounded up."""
    d = np.arange(-ceil(2 * sigma_px), ceil(2 * sigma_px) + 1)
    line = np.exp(-(d**2) / (2 * sigma_px**2))
    return np.outer(line, line).astype(np.float32)


@parallel
def smooth(i: int, q: Any, variance: Any, weights: Any, inflation: Any, xyz: Any, sigma: Any) -> None:
    """Smooth a row; its sigma falls as that of the fit does.

    Args:
        q, variance: (H, W) float32, of :func:`pipeline.filter.cloud.surface_tangent.inverse_depth`.
        weights: (2 r + 1, 2 r + 1) float32; inflation: variance of their mean over that with independent noise.
        xyz: (H, W, 3), mm, sigma: (H, W), mm, float32, changed.
    """
    height, width = q.shape
    radius = weights.shape[0] // 2
    chosen = np.empty(weights.shape, np.float32)
    for j in range(width):
        here, noise = q[i, j], variance[i, j]
        if here != here:
            continue
        plane = tangent(q, variance, i, j)
        n, sx, sy, sxx, sxy, syy = (np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0),
                                    np.float32(0))  # fmt: skip
        top, bottom = max(-radius, -i), min(radius, height - 1 - i)
        left, right = max(-radius, -j), min(radius, width - 1 - j)
        for b in range(top, bottom + 1):
            y = np.float32(b)
            for a in range(left, right + 1):
                x = np.float32(a)
                w = weights[radius + b, radius + a]
                if not on_plane(q[i + b, j + a], variance[i + b, j + a], here, noise, plane, x, y):
                    w = np.float32(0)
                chosen[radius + b, radius + a] = w
                n += w
                sx += w * x
                sy += w * y
                sxx += w * x * x
                sxy += w * x * y
                syy += w * y * y
        # Value of the fit at the middle: sum of w (c0 + c1 x + c2 y) q with the first row of the inverse.
        c0, c1, c2 = sxx * syy - sxy * sxy, sxy * sy - sx * syy, sx * sxy - sxx * sy
        determinant = n * c0 + sx * c1 + sy * c2
        if determinant > _LEAST * n * sxx * syy and determinant > 0:
            c0, c1, c2 = c0 / determinant, c1 / determinant, c2 / determinant
        else:
            c0, c1, c2 = _ONE / n, np.float32(0), np.float32(0)
        total, spread = np.float32(0), np.float32(0)
        for b in range(top, bottom + 1):
            for a in range(left, right + 1):
                w = chosen[radius + b, radius + a]
                if w != np.float32(0):
                    share = w * (c0 + c1 * np.float32(a) + c2 * np.float32(b))
                    total += share * (q[i + b, j + a] - here)
                    spread += share * share * variance[i + b, j + a]
        scale = here / (here + total)
        xyz[i, j, 0] *= scale
        xyz[i, j, 1] *= scale
        xyz[i, j, 2] *= scale
        # Few neighbours are less correlated than all of them, and a fit is never worse than the point alone.
        sigma[i, j] *= np.sqrt(min(spread * inflation / noise, _ONE))
