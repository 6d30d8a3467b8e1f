"""Smoothing along the surface: a weighted plane fit around every point, over neighbours on its tangent plane only.

Steps stay sharp, as points beyond them are not on the plane; planes of any tilt, and their borders, are not displaced,
as the fit has a slope. Every point stays on its viewing ray.
"""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import inline, linked, serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE, root
from pipeline.filter.cloud.surface_tangent import NEVER, ON_PLANE, slope

_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_LEAST = np.float32(1e-6)
"""Determinant of a fit, over the product of its diagonal, below which only the mean is taken."""
TOGETHER = 3
"""Neighbours of a row that are added in one go."""
# Offsets in the scratch array: sums of the weights and of their products with the neighbours' offsets, of the
# differences of inverse depth, and of the variances; the tangent plane's slopes and their variances.
_N, _SX, _SY, _SXX, _SXY, _SYY, _D, _DX, _DY, _V, _VX, _VY, _VXX, _VXY, _VYY = range(0, 15 * TILE, TILE)
_SUMS = 15 * TILE
_SLOPE_X, _NOISE_X, _SLOPE_Y, _NOISE_Y, _SCALE, _FACTOR = range(_SUMS, _SUMS + 6 * TILE, TILE)
_SCRATCH = 21 * TILE


def kernel(sigma_px: float) -> NDArray[np.float32]:
    """Gaussian weights (2 r + 1, 2 r + 1), r = 2 sigma rounded up."""
    d = np.arange(-ceil(2 * sigma_px), ceil(2 * sigma_px) + 1)
    line = np.exp(-(d**2) / (2 * sigma_px**2))
    return np.outer(line, line).astype(np.float32)


@linked
def _tangents(q: Any, variance: Any, at: Any, pitch: Any, s: Any) -> None:
    """Slopes of the tangent planes of TILE pixels from number ``at`` on; without one no pixel along is on the plane."""
    for j in range(TILE):
        k = at + np.uint64(j)
        here, noise = q[k], variance[k]
        x, x_noise = slope(q[k - np.uint64(1)], here, q[k + np.uint64(1)], noise)
        y, y_noise = slope(q[k - pitch], here, q[k + pitch], noise)
        s[_SLOPE_X + j], s[_NOISE_X + j] = x if x == x else _ZERO, x_noise if x == x else NEVER
        s[_SLOPE_Y + j], s[_NOISE_Y + j] = y if y == y else _ZERO, y_noise if y == y else NEVER


@inline
def _chosen(off: Any, here: Any, noise: Any, other: Any, other_noise: Any, allowed: Any) -> Any:
    """Difference of inverse depth to a neighbour, its variance, and 1; all 0 where it is not on the tangent plane."""
    d = other - here
    away = d - off
    on = away * away <= ON_PLANE * (noise + other_noise + allowed)
    return d if on else _ZERO, other_noise if on else _ZERO, _ONE if on else _ZERO


@serial
def _add(q: Any, variance: Any, at: Any, to: Any, weights: Any, b: int, a: int, s: Any) -> None:
    """Add TOGETHER neighbours of a row to the sums of TILE pixels.

    Args:
        q, variance: flat; at: number of the first pixel; to: of the first pixel's first neighbour.
        weights: of the window; b, a: row and column of the first neighbour in it.
    """
    radius = weights.shape[0] // 2
    x, y = np.float32(a - radius), np.float32(b - radius)
    x1, x2 = x + _ONE, x + _TWO
    g0, g1, g2 = weights[b, a], weights[b, a + 1], weights[b, a + 2]
    for j in range(TILE):
        k, m = at + np.uint64(j), to + np.uint64(j)
        here, noise = q[k], variance[k]
        sx, nx = s[_SLOPE_X + j], s[_NOISE_X + j]
        off, allowed = s[_SLOPE_Y + j] * y, s[_NOISE_Y + j] * y * y
        d0, v0, w0 = _chosen(off + sx * x, here, noise, q[m], variance[m], allowed + nx * x * x)
        m += np.uint64(1)
        d1, v1, w1 = _chosen(off + sx * x1, here, noise, q[m], variance[m], allowed + nx * x1 * x1)
        m += np.uint64(1)
        d2, v2, w2 = _chosen(off + sx * x2, here, noise, q[m], variance[m], allowed + nx * x2 * x2)
        n = w0 * g0 + w1 * g1 + w2 * g2
        nx = w0 * (g0 * x) + w1 * (g1 * x1) + w2 * (g2 * x2)
        s[_N + j] += n
        s[_SX + j] += nx
        s[_SXX + j] += w0 * (g0 * x * x) + w1 * (g1 * x1 * x1) + w2 * (g2 * x2 * x2)
        s[_SY + j] += n * y
        s[_SXY + j] += nx * y
        s[_SYY + j] += n * (y * y)
        n = d0 * g0 + d1 * g1 + d2 * g2
        s[_D + j] += n
        s[_DX + j] += d0 * (g0 * x) + d1 * (g1 * x1) + d2 * (g2 * x2)
        s[_DY + j] += n * y
        n = v0 * (g0 * g0) + v1 * (g1 * g1) + v2 * (g2 * g2)
        nx = v0 * (g0 * g0 * x) + v1 * (g1 * g1 * x1) + v2 * (g2 * g2 * x2)
        s[_V + j] += n
        s[_VX + j] += nx
        s[_VXX + j] += v0 * (g0 * g0 * x * x) + v1 * (g1 * g1 * x1 * x1) + v2 * (g2 * g2 * x2 * x2)
        s[_VY + j] += n * y
        s[_VXY + j] += nx * y
        s[_VYY + j] += n * (y * y)


@serial
def _solve(q: Any, variance: Any, at: Any, inflation: Any, s: Any) -> None:
    """Factors of the points' positions and of their sigma."""
    for j in range(TILE):
        k = at + np.uint64(j)
        n, sx, sy, sxx, sxy, syy = s[_N + j], s[_SX + j], s[_SY + j], s[_SXX + j], s[_SXY + j], s[_SYY + j]
        # Value of the fit at the middle: sum of w (c0 + c1 x + c2 y) q with the first row of the inverse.
        c0, c1, c2 = sxx * syy - sxy * sxy, sxy * sy - sx * syy, sx * sxy - sxx * sy
        determinant = n * c0 + sx * c1 + sy * c2
        regular = (determinant > _LEAST * n * sxx * syy) & (determinant > _ZERO)
        c0, c1, c2 = c0 if regular else _ONE, c1 if regular else _ZERO, c2 if regular else _ZERO
        inverse = _ONE / (determinant if regular else n)
        total = (c0 * s[_D + j] + c1 * s[_DX + j] + c2 * s[_DY + j]) * inverse
        spread = c0 * c0 * s[_V + j] + c1 * c1 * s[_VXX + j] + c2 * c2 * s[_VYY + j]
        spread += _TWO * (c0 * c1 * s[_VX + j] + c0 * c2 * s[_VY + j] + c1 * c2 * s[_VXY + j])
        s[_SCALE + j] = q[k] / (q[k] + total)
        # Few neighbours are less correlated than all of them, and a fit is never worse than the point alone.
        s[_FACTOR + j] = root(min(max(spread, _ZERO) * inverse * inverse * inflation / variance[k], _ONE))


@parallel_allocating
def smooth(i: int, q: Any, variance: Any, pitch: Any, weights: Any, inflation: Any, xyz: Any, sigma: Any) -> None:
    """Smooth a row; its sigma falls as that of the fit does.

    Args:
        q, variance: flat float32, of :func:`pipeline.filter.cloud.surface_tangent.inverse_depth` with a margin of
            the radius r and a spacing of rows ``pitch`` (uint64).
        weights: (2 r + 1, m) float32, m = 2 r + 1 rounded up to a multiple of TOGETHER; added ones are 0.
        inflation: variance of their mean over that with independent noise.
        xyz: (H, 3 W), mm, sigma: (H, W), mm, float32, changed.
    """
    width = sigma.shape[1]
    radius = weights.shape[0] // 2
    s = np.empty(_SCRATCH, np.float32)
    for left in range(0, width, TILE):
        at = np.uint64(i + radius) * pitch + np.uint64(left + radius)
        _tangents(q, variance, at, pitch, s)
        for j in range(_SUMS):
            s[j] = _ZERO
        for b in range(weights.shape[0]):
            to = np.uint64(i + b) * pitch + np.uint64(left)
            for a in range(0, weights.shape[1], TOGETHER):
                _add(q, variance, at, to + np.uint64(a), weights, b, a, s)
        _solve(q, variance, at, inflation, s)
        points, sigmas = xyz[i, 3 * left :], sigma[i, left:]
        for j in range(min(TILE, width - left)):
            scale = s[_SCALE + j]
            points[3 * j], points[3 * j + 1], points[3 * j + 2] = (
                points[3 * j] * scale, points[3 * j + 1] * scale, points[3 * j + 2] * scale
            )  # fmt: skip
            sigmas[j] *= s[_FACTOR + j]
