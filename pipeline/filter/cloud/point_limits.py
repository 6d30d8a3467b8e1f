"""Limits of single points: noise, distance from neighbours, region of interest. What is outside becomes NaN."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked
from pipeline.common.parallel_for import parallel, parallel_allocating

_NAN = np.float32(np.nan)
_YES, _NO = np.uint8(1), np.uint8(0)
_FEWEST = 2
"""Neighbours that a point needs nearby."""
ROWS = 32
"""Rows of a band of :func:`isolated_points`."""


@parallel
def noise_limit(i: int, limit: Any, xyz: Any, sigma: Any) -> None:
    """Reject points whose sigma exceeds a limit, mm; ``xyz`` (H, W, 3) and ``sigma`` (H, W) are changed."""
    for j in range(sigma.shape[1]):
        if sigma[i, j] > limit:
            xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2], sigma[i, j] = _NAN, _NAN, _NAN, _NAN


@linked
def _load_row(points: Any, row: Any) -> None:
    """Coordinates of a row (3 W,) as (3, W + 2), with an unknown point before and after it."""
    x, y, z = row[0, 1:], row[1, 1:], row[2, 1:]
    for j in range(x.shape[0] - 1):
        x[j], y[j], z[j] = points[3 * j], points[3 * j + 1], points[3 * j + 2]


@linked
def _mark_row(above: Any, here: Any, below: Any, limit: Any, alone: Any) -> Any:
    """Mark the known points with too few neighbours, and return their number; ``limit`` is squared."""
    count = 0
    for j in range(alone.shape[0]):
        x, y, z = here[0, j + 1], here[1, j + 1], here[2, j + 1]
        near = 0
        for row in (above, here, below):
            for k in range(3):
                dx, dy, dz = row[0, j + k] - x, row[1, j + k] - y, row[2, j + k] - z
                near += 1 if dx * dx + dy * dy + dz * dz <= limit else 0
        lonely = (near <= _FEWEST) & (z == z)  # the point itself is among them
        alone[j] = _YES if lonely else _NO
        count += 1 if lonely else 0
    return count


@parallel_allocating
def isolated_points(band: int, xyz: Any, limit: Any, alone: Any, count: Any) -> None:
    """Mark points with fewer than two of their eight neighbours within a distance, in a band of ROWS rows.

    Args:
        xyz: (H, 3 W) float32, mm; limit: mm; alone: (H, W) uint8, becomes 1 where isolated, else 0.
        count: (H,) int64, becomes the number of isolated points of each row.
    """
    height, width = alone.shape
    low, high = band * ROWS, min(band * ROWS + ROWS, height)
    rows = np.full((3, 3, width + 2), _NAN, np.float32)
    for i in range(low - 1, high + 1):
        if 0 <= i < height:
            _load_row(xyz[i], rows[i % 3])
        else:
            rows[i % 3] = _NAN
        if i > low:
            count[i - 1] = _mark_row(rows[(i - 2) % 3], rows[(i - 1) % 3], rows[i % 3], limit * limit, alone[i - 1])


@parallel
def reject(i: int, marked: Any, count: Any, xyz: Any, sigma: Any) -> None:
    """Reject the marked points of a row; see :func:`isolated_points`; ``xyz`` and ``sigma`` are changed."""
    if count[i] == 0:
        return
    for j in range(sigma.shape[1]):
        if marked[i, j] != _NO:
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
