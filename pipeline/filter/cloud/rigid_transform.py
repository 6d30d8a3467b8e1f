"""A cloud in another frame."""

from __future__ import annotations

from typing import Any

from pipeline.common.parallel_for import parallel


@parallel
def transform(i: int, pose: Any, xyz: Any, out: Any) -> None:
    """Transform a row of points; NaN stays NaN.

    Args:
        pose: (3, 4) float32, rotation and translation; xyz: (H, 3 W) float32, mm; out: alike, written.
    """
    a, b, c, x0 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    d, e, f, y0 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    g, h, k, z0 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    points, moved = xyz[i], out[i]
    for j in range(0, points.shape[0], 3):
        x, y, z = points[j], points[j + 1], points[j + 2]
        moved[j] = a * x + b * y + c * z + x0
        moved[j + 1] = d * x + e * y + f * z + y0
        moved[j + 2] = g * x + h * y + k * z + z0
