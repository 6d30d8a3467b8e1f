"""Response of the observed projector coordinate to a displacement of a camera's image, by patch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.calibration import Calibration

F64 = NDArray[np.float64]

_STEP_MM = 1.0


def in_image(calibration: Calibration, points: F64) -> tuple[F64, F64]:
    """Position of world points in the left image, -1 .. 1 from edge to edge, x and y."""
    width, height = calibration.left.size
    pixels = calibration.left.project(points)
    return 2 * pixels[:, 0] / (width - 1) - 1, 2 * pixels[:, 1] / (height - 1) - 1


def along_ray(calibration: Calibration, points: F64, first: int) -> tuple[F64, F64]:
    """Change of the projector's coordinate (n,) and of the right pixel (n, 2) when a point moves along its left ray."""
    further = points * (1 + _STEP_MM / points[:, 2:3])
    projector = calibration.projector.project(further) - calibration.projector.project(points)
    return projector[:, first], calibration.right.project(further) - calibration.right.project(points)


def per_depth(calibration: Calibration, points: F64, first: int) -> tuple[F64, F64]:
    """Change of the projector's coordinate per mm of depth, (n,), along left rays of points and along right ones."""
    from_right = points - calibration.right.centre
    further = points + from_right * (_STEP_MM / from_right[:, 2:3])
    along_right = calibration.projector.project(further) - calibration.projector.project(points)
    return along_ray(calibration, points, first)[0] / _STEP_MM, along_right[:, first] / _STEP_MM


def in_the_middle(calibration: Calibration, distance_mm: float) -> F64:
    """(1, 3) point in the middle of the left image."""
    ray = calibration.left.normalise((np.array([calibration.left.size]) - 1.0) / 2)[0]
    return np.array([[*ray, 1.0]]) * distance_mm


def displacement_response(calibration: Calibration, shape: F64, first: int) -> tuple[F64, F64]:
    """Change of observed minus predicted projector coordinate per pixel of displacement of the right image, u and v.

    The match slides along the epipolar curve (u_s, v_s) until the phase agrees: a displacement (du, dv) moves it by
    ``ds = (F_u du + F_v dv) / (F_u u_s + F_v v_s)``, F the phase in the right image, and the predicted projector
    coordinate by p_s ds.

    Args:
        shape: (n, 14), as of :func:`pipeline.monitor.patches.measure_patches`.
    """
    p, shift = along_ray(calibration, shape[:, :3], first)
    slope_u, slope_v = shape[:, 8], shape[:, 9]
    along = slope_u * shift[:, 0] + slope_v * shift[:, 1]
    return -p * slope_u / along, -p * slope_v / along


def design(calibration: Calibration, shape: F64, first: int) -> F64:
    """(n, 4) regressors of the residual: 1, position x and y, response to a displacement across the epipolar lines."""
    x, y = in_image(calibration, shape[:, :3])
    across = displacement_response(calibration, shape, first)[1 - first]
    return np.stack([np.ones_like(x), x, y, across], axis=1)
