"""The projection of marks with all its derivatives, for many marks at once.

Exactly :class:`pipeline.rig.camera_model.CameraModel`; the derivatives are checked against differences in the tests.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.state import State

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Projected(NamedTuple):
    """Pixels of n points and their derivatives.

    Attributes:
        pixels: (n, 2); NaN behind the device.
        of_device: (n, 2, 16), by the device's unknowns in the order of :mod:`pipeline.calibrate.bundle.adjust.state`.
        of_view: (n, 2, 6), by the view's unknowns.
        of_point: (n, 2, 3), by the position on the board.
    """

    pixels: Array
    of_device: Array
    of_view: Array
    of_point: Array


def image(intrinsics: Array, points: Array) -> Array:
    """Pixels (n, 2) of points (n, 3) in the device's frame, intrinsics (n, 10) or (10,); NaN behind it."""
    fx, fy, skew, cx, cy, k1, k2, p1, p2, k3 = np.moveaxis(intrinsics, -1, 0)
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    x, y = points[..., 0] / z, points[..., 1] / z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([fx * xd + skew * yd + cx, fy * yd + cy], axis=-1)


def image_with_slopes(intrinsics: Array, points: Array) -> tuple[Array, Array, Array]:
    """Pixels (n, 2), derivatives by the intrinsics (n, 2, 10) and by the point (n, 2, 3)."""
    fx, fy, skew, cx, cy, k1, k2, p1, p2, k3 = np.moveaxis(np.broadcast_to(intrinsics, (len(points), 10)), -1, 0)
    z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    x, y = points[:, 0] / z, points[:, 1] / z
    r2, xy = x * x + y * y, x * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * xy
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    both = slope * xy + 2 * p1 * x + 2 * p2 * y
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    zero, one = np.zeros_like(x), np.ones_like(x)
    # Derivatives of the distorted normalised point by k1, k2, p1, p2, k3.
    r4, r6 = r2 * r2, r2 * r2 * r2
    dx = (x * r2, x * r4, 2 * xy, r2 + 2 * x * x, x * r6)
    dy = (y * r2, y * r4, r2 + 2 * y * y, 2 * xy, y * r6)
    of_intrinsics = np.empty((len(points), 2, 10))
    for k, column in enumerate((xd, zero, yd, one, zero, *(fx * a + skew * b for a, b in zip(dx, dy, strict=True)))):
        of_intrinsics[:, 0, k] = column
    for k, column in enumerate((zero, yd, zero, zero, one, *(fy * b for b in dy))):
        of_intrinsics[:, 1, k] = column
    ux, uy = fx * xx + skew * both, fx * both + skew * yy
    vx, vy = fy * both, fy * yy
    of_point = np.empty((len(points), 2, 3))
    for row, (along_x, along_y) in enumerate(((ux, uy), (vx, vy))):
        for k, column in enumerate((along_x, along_y, -(along_x * x + along_y * y))):
            of_point[:, row, k] = column / z
    pixels = np.stack([fx * xd + skew * yd + cx, fy * yd + cy], axis=-1)
    return pixels, of_intrinsics, of_point


def in_device(state: State, device: Index, view: Index, mark: Index) -> Array:
    """Marks in the frames of their devices, (n, 3) mm, of device, view and mark numbers (n,) each."""
    world = np.einsum("nij,nj->ni", state.view_rotations[view], state.points[mark]) + state.view_translations[view]
    return np.asarray(np.einsum("nij,nj->ni", state.rotations[device], world) + state.translations[device])


def project(state: State, device: Index, view: Index, mark: Index) -> Array:
    """Pixels (n, 2) of marks; NaN behind the device."""
    return image(state.intrinsics[device], in_device(state, device, view, mark))


def project_with_slopes(state: State, device: Index, view: Index, mark: Index) -> Projected:
    """Pixels of marks with the derivatives by all unknowns."""
    r, view_r = state.rotations[device], state.view_rotations[view]
    on_board = np.einsum("nij,nj->ni", view_r, state.points[mark])
    world = on_board + state.view_translations[view]
    rotated = np.einsum("nij,nj->ni", r, world)
    pixels, of_intrinsics, of_xyz = image_with_slopes(state.intrinsics[device], rotated + state.translations[device])
    of_world = of_xyz @ r
    # g . (w x p) = w . (p x g): the derivative by a small rotation w of a point p.
    of_device = np.concatenate([of_intrinsics, np.cross(rotated[:, None], of_xyz), of_xyz], axis=-1)
    of_view = np.concatenate([np.cross(on_board[:, None], of_world), of_world], axis=-1)
    return Projected(pixels, of_device, of_view, of_world @ view_r)
