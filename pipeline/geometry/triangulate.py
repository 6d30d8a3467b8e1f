"""Least-squares triangulation of two views, the reference.

The undistorted normalised point (x, y) of a device with pose (R, t) gives two linear equations in the world point X:
``(x r3 - r1) X = t1 - x t3`` and ``(y r3 - r2) X = t2 - y t3`` (r: rows of R). Two views give four for three unknowns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.camera_model import CameraModel

F64 = NDArray[np.float64]


def triangulate(
    left: CameraModel, right: CameraModel, left_px: F64, right_px: F64, *, weights: tuple[float, float] = (1.0, 1.0)
) -> F64:
    """World points of matched pixels, (..., 2), (..., 2) -> (..., 3) mm.

    Args:
        weights: of the two views' equations, inverse standard deviations of their pixel coordinates.
    """
    rows, values = zip(
        *(_equations(d, px, w) for d, px, w in ((left, left_px, weights[0]), (right, right_px, weights[1]))),
        strict=True,
    )
    a, b = np.concatenate(rows, axis=-2), np.concatenate(values, axis=-1)
    transposed = np.swapaxes(a, -1, -2)
    normal = transposed @ a
    return np.asarray(np.linalg.solve(normal, (transposed @ b[..., None]))[..., 0])


def _equations(device: CameraModel, pixels: F64, weight: float) -> tuple[F64, F64]:
    points = device.normalise(pixels)
    r, t = device.rotation, device.translation
    rows = weight * (points[..., :, None] * r[2] - r[:2])
    values = weight * (t[:2] - points * t[2])
    return rows, values
