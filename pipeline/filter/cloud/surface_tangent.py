"""The tangent plane of a surface at a pixel, and whether another pixel lies on it.

Filters work on the inverse depth q = 1/z: of a plane it is an affine function of the normalised image coordinates, and
over a few pixels of a distorted image nearly one of the pixel coordinates, whatever the plane's tilt is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel

_NAN, _ZERO, _HALF, _TWO = np.float32(np.nan), np.float32(0), np.float32(0.5), np.float32(2)
_STRAIGHT = np.float32(16 * 6)
"""Squared second difference, in variances of one pixel, up to which both sides of a pixel are one surface: (4 sigma)^2,
and the second difference has six times the variance of a pixel."""
ON_PLANE = np.float32(9)
"""Squared distance from the tangent plane, in variances, up to which a pixel is on it."""
NEVER = np.float32(-1e30)
"""Variance of a slope that is unknown, for sums without a test: nothing is near enough then."""


@parallel
def inverse_depth(i: int, xyz: Any, sigma: Any, margin: int, q: Any, variance: Any) -> None:
    """Inverse depth of a row and its variance; both NaN where unknown.

    Args:
        xyz: (H, 3 W) float32, mm; sigma: (H, W) float32, mm along the viewing ray.
        margin: rows and columns of the results before those of the cloud.
        q: (H + margin, W + margin or more) float32, written, 1/mm; variance: alike, written, 1/mm^2.
    """
    inverses, variances, points, sigmas = q[i + margin, margin:], variance[i + margin, margin:], xyz[i], sigma[i]
    for j in range(sigmas.shape[0]):
        x, y, z = points[3 * j], points[3 * j + 1], points[3 * j + 2]
        inverse = np.float32(1) / z
        along = sigmas[j] * inverse * inverse
        # Along the ray a step of sigma changes z by sigma z / |xyz|.
        inverses[j], variances[j] = inverse, along * along * z * z / (x * x + y * y + z * z)


@inline
def slope(before: Any, here: Any, after: Any, variance: Any) -> Any:
    """Slope of q per pixel along one axis and its variance, from both neighbours of a pixel (NaN: unknown).

    At a step the side with the smaller difference counts, which does not lead to the other surface.
    """
    back, ahead = here - before, after - here
    bend = ahead - back
    straight = bend * bend <= _STRAIGHT * variance
    one = back if (abs(back) <= abs(ahead)) | (ahead != ahead) else ahead
    return _HALF * (back + ahead) if straight else one, variance * (_HALF if straight else _TWO)


@inline
def tangent(q: Any, variance: Any, i: int, j: int) -> Any:
    """Slopes of q along x and y at a known pixel and their variances; NaN along an axis without a neighbour."""
    height, width = q.shape
    here, noise = q[i, j], variance[i, j]
    x, x_noise = slope(
        q[i, j - 1] if j > 0 else _NAN, here, q[i, j + 1] if j < width - 1 else _NAN, noise
    )  # fmt: skip
    y, y_noise = slope(
        q[i - 1, j] if i > 0 else _NAN, here, q[i + 1, j] if i < height - 1 else _NAN, noise
    )  # fmt: skip
    return x, x_noise, y, y_noise


@inline
def on_plane(other: Any, other_noise: Any, here: Any, noise: Any, plane: Any, x: Any, y: Any) -> bool:
    """Whether a pixel (x, y) pixels away continues a pixel's tangent plane; False where it is unknown."""
    off, allowed = other - here, other_noise + noise
    if x != _ZERO:
        off -= plane[0] * x
        allowed += plane[1] * x * x
    if y != _ZERO:
        off -= plane[2] * y
        allowed += plane[3] * y * y
    return off * off <= ON_PLANE * allowed
