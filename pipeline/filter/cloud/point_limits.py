"""Limits of single points: noise, distance from neighbours, region of interest. What is outside becomes NaN."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import parallel

_NAN = np.float32(np.nan)
_FEWEST = 2
"""Neighbours that a point needs nearby."""


@parallel
def noise_limit(i: int, limit: Any, xyz: Any, sigma: Any) -> None:
    """Reject points whose sigma exceeds a limit, mm; ``xyz`` (H, W, 3) and ``sigma`` (H, W) are changed."""
    for j in range(sigma.shape[1]):
        if sigma[i, j] > limit:
            xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2], sigma[i, j] = _NAN, _NAN, _NAN, _NAN


@parallel
def isolated_points(i: int, points: Any, limit: Any, xyz: Any, sigma: Any) -> None:
    """Reject points with fewer than two of their eight neighbours within a distance.

    Args:
        points: (H, W, 3) float32, mm; limit: mm; xyz: a copy of ``points``, changed; sigma: (H, W), changed.
    """
    height, width = sigma.shape
    for j in range(width):
        x, y, z = points[i, j, 0], points[i, j, 1], points[i, j, 2]
        near = 0
        for a in range(max(0, i - 1), min(height, i + 2)):
            for b in range(max(0, j - 1), min(width, j + 2)):
                dx, dy, dz = points[a, b, 0] - x, points[a, b, 1] - y, points[a, b, 2] - z
                near += int(dx * dx + dy * dy + dz * dz <= limit * limit)
        if near <= _FEWEST:  # the point itself is among them
            xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2], sigma[i, j] = _NAN, _NAN, _NAN, _NAN


@parallel
def outside_region(i: int, pose: Any, box: Any, rectangle: Any, xyz: Any, sigma: Any) -> None:
    """Reject points outside of a box in another frame, or of a rectangle of the image.

    Args:
        pose: (3, 4) float32, from the cloud's frame to that of the box; box: (6,) float32, least and largest x, y, z.
        rectangle: (4,) int64, first and last column, first and last row, inclusive.
        xyz: (H, W, 3), sigma: (H, W), float32, changed.
    """
    for j in range(sigma.shape[1]):
        x, y, z = xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2]
        inside = (j >= rectangle[0]) & (j <= rectangle[1]) & (i >= rectangle[2]) & (i <= rectangle[3])
        for axis in range(3):
            at = pose[axis, 0] * x + pose[axis, 1] * y + pose[axis, 2] * z + pose[axis, 3]
            inside &= (at >= box[2 * axis]) & (at <= box[2 * axis + 1])
        if not inside:
            xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2], sigma[i, j] = _NAN, _NAN, _NAN, _NAN
