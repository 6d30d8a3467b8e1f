"""Camera models for compiled code: a vector of parameters, and the projection in both directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import unowned
from pipeline.rig.camera_model import CameraModel
from sim.scene.jit import compiled, inline

Array = NDArray[np.float64]


def packed(device: CameraModel) -> Array:
    """The device as (27,): intrinsics 0-4, distortion 5-9, rotation 10-18, translation 19-21, centre 22-24, size."""
    m = device.matrix
    intrinsics = [m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2]]
    parts = [intrinsics, device.distortion, device.rotation.ravel(), device.translation, device.centre, device.size]
    return np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])


@inline
def distorted(d: Array, x: float, y: float) -> tuple[float, float]:
    """Distorted normalised point of an ideal one."""
    r2 = x * x + y * y
    radial = 1 + r2 * (d[5] + r2 * (d[6] + r2 * d[9]))
    return (
        x * radial + 2 * d[7] * x * y + d[8] * (r2 + 2 * x * x),
        y * radial + d[7] * (r2 + 2 * y * y) + 2 * d[8] * x * y,
    )


@inline
def pixel_of(d: Array, px: float, py: float, pz: float) -> tuple[float, float, float]:
    """Pixel (u, v) and depth of a world point; the depth is negative behind the device."""
    x = d[10] * px + d[11] * py + d[12] * pz + d[19]
    y = d[13] * px + d[14] * py + d[15] * pz + d[20]
    z = d[16] * px + d[17] * py + d[18] * pz + d[21]
    if z <= 0:
        return -1e9, -1e9, z
    xd, yd = distorted(d, x / z, y / z)
    return d[0] * xd + d[1] * yd + d[2], d[3] * yd + d[4], z


@inline
def ray_of(d: Array, u: float, v: float) -> tuple[float, float, float]:
    """Unit direction in the world of the ray through a pixel."""
    yt = (v - d[4]) / d[3]
    xt = (u - d[2] - d[1] * yt) / d[0]
    x, y = xt, yt
    for _ in range(30):
        # The distortion is small: a fixed point iteration gains several digits a round.
        xd, yd = distorted(d, x, y)
        ex, ey = xt - xd, yt - yd
        x += ex
        y += ey
        if abs(ex) + abs(ey) < 1e-15:
            break
    wx = d[10] * x + d[13] * y + d[16]
    wy = d[11] * x + d[14] * y + d[17]
    wz = d[12] * x + d[15] * y + d[18]
    scale = 1 / np.sqrt(wx * wx + wy * wy + wz * wz)
    return wx * scale, wy * scale, wz * scale


@compiled
def pixel_rays(d: Array, first_row: int, rows: int, columns: int, step: float, left: float, top: float) -> Array:
    """Rays of samples at pixels (left + step j, top + step (first_row + i)), (rows * columns, 3)."""
    d = unowned(d)
    out = np.empty((rows * columns, 3))
    for i in range(rows):
        for j in range(columns):
            x, y, z = ray_of(d, left + step * j, top + step * (first_row + i))
            k = i * columns + j
            out[k, 0], out[k, 1], out[k, 2] = x, y, z
    return out


@compiled
def pixels_of(d: Array, points: Array) -> Array:
    """Pixels of world points, (n, 3) -> (n, 2)."""
    d = unowned(d)
    out = np.empty((len(points), 2))
    for k in range(len(points)):
        out[k, 0], out[k, 1], _ = pixel_of(d, points[k, 0], points[k, 1], points[k, 2])
    return out
