"""The projection of marks with all its derivatives, for many marks at once.

Exactly :class:`pipeline.camera_model.CameraModel`; the derivatives are checked against differences in the tests.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.bundle.state import State, cross_matrices

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Projected(NamedTuple):
    """Pixels of n points and their derivatives.

    Attributes:
        pixels: (n, 2); NaN behind the device.
        of_device: (n, 2, 16), by the device's unknowns in the order of :mod:`pipeline.bundle.state`.
        of_view: (n, 2, 6), by the view's unknowns.
        of_point: (n, 2, 3), by the place on the board.
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
    dx = np.stack([x * r2, x * r2**2, 2 * xy, r2 + 2 * x * x, x * r2**3], axis=-1)
    dy = np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * xy, y * r2**3], axis=-1)
    of_u = np.concatenate([np.stack([xd, zero, yd, one, zero], -1), fx[:, None] * dx + skew[:, None] * dy], axis=-1)
    of_v = np.concatenate([np.stack([zero, yd, zero, zero, one], -1), fy[:, None] * dy], axis=-1)
    ux, uy = fx * xx + skew * both, fx * both + skew * yy
    vx, vy = fy * both, fy * yy
    of_point = np.stack(
        [
            np.stack([ux, uy, -(ux * x + uy * y)], -1) / z[:, None],
            np.stack([vx, vy, -(vx * x + vy * y)], -1) / z[:, None],
        ],
        axis=1,
    )
    pixels = np.stack([fx * xd + skew * yd + cx, fy * yd + cy], axis=-1)
    return pixels, np.stack([of_u, of_v], axis=1), of_point


def in_device(state: State, device: Index, view: Index, mark: Index) -> Array:
    """Marks in the frames of their devices, (n, 3) mm, of device, view and mark numbers (n,) each."""
    world = np.einsum("nij,nj->ni", state.view_rotations[view], state.points[mark]) + state.view_translations[view]
    return np.asarray(np.einsum("nij,nj->ni", state.rotations[device], world) + state.translations[device])


def project(state: State, device: Index, view: Index, mark: Index) -> Array:
    """Pixels (n, 2) of marks; NaN behind the device."""
    return image(state.intrinsics[device], in_device(state, device, view, mark))


def project_with_slopes(state: State, device: Index, view: Index, mark: Index) -> Projected:
    """Pixels of marks with the derivatives by everything."""
    turn, view_turn = state.rotations[device], state.view_rotations[view]
    on_board = np.einsum("nij,nj->ni", view_turn, state.points[mark])
    world = on_board + state.view_translations[view]
    turned = np.einsum("nij,nj->ni", turn, world)
    pixels, of_intrinsics, of_place = image_with_slopes(state.intrinsics[device], turned + state.translations[device])
    of_world = of_place @ turn
    of_device = np.concatenate([of_intrinsics, -of_place @ cross_matrices(turned), of_place], axis=-1)
    of_view = np.concatenate([-of_world @ cross_matrices(on_board), of_world], axis=-1)
    return Projected(pixels, of_device, of_view, of_world @ view_turn)
