"""The cloud's planes from the located points and what the gates left of them, each written once."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange, serial

_NAN = np.float32(np.nan)
_NOWHERE = np.int16(-1)
_ZERO, _MOST = np.float32(0.0), np.float32(255.0)


@serial
def _depths(known: Any, depth: Any, every: int, out: Any) -> None:
    if every == 1:
        for j in range(out.shape[0]):
            out[j] = depth[j] if known[j] != 0 else _NAN
        return
    out[:] = _NAN
    for j in range(known.shape[0]):
        out[every * j] = depth[j] if known[j] != 0 else _NAN


@serial
def _points(z: Any, ray_x: Any, ray_y: Any, every: int, out: Any) -> None:
    if every == 1:
        for j in range(z.shape[0]):
            out[j, 0] = ray_x[j] * z[j]
            out[j, 1] = ray_y[j] * z[j]
            out[j, 2] = z[j]
        return
    out[:] = _NAN
    for j in range(ray_x.shape[0]):
        m = every * j
        out[m, 0], out[m, 1], out[m, 2] = ray_x[j] * z[m], ray_y[j] * z[m], z[m]


@serial
def _orders(known: Any, order: Any, every: int, out: Any) -> None:
    if every == 1:
        for j in range(out.shape[0]):
            out[j] = order[j] if known[j] != 0 else _NOWHERE
        return
    out[:] = _NOWHERE
    for j in range(known.shape[0]):
        out[every * j] = order[j] if known[j] != 0 else _NOWHERE


@serial
def _counts(mean: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        x = np.rint(mean[j])
        x = x if x > _ZERO else _ZERO
        out[j] = np.uint8(np.int32(x if x < _MOST else _MOST))


@parallel
def assemble(
    known: Any, depth: Any, sigma: Any, ray_x: Any, ray_y: Any, mean: Any, order: Any, every: int
) -> tuple[Any, Any, Any, Any]:
    """Points, their sigma, gray values and orders.

    Args:
        known: (h, w) uint8; depth, sigma: (h, w) float32 mm, read where known.
        ray_x, ray_y: (h, w) float32, ideal normalised points of the pixels; order: (h, w) int16.
        mean: (H, W) float32, counts; every: pixel (a, b) of the planes (h, w) is the picture's (every a, every b).

    Returns:
        xyz (H, W, 3) float32 mm and sigma (H, W) float32 mm, NaN where unknown; gray (H, W) uint8, everywhere;
        order (H, W) int16, -1 where unknown.
    """
    height, width = mean.shape
    xyz = np.empty((height, width, 3), np.float32)
    sigma_out = np.empty((height, width), np.float32)
    gray = np.empty((height, width), np.uint8)
    order_out = np.empty((height, width), np.int16)
    for i in prange(height):
        _counts(mean[i], gray[i])
        if i % every:
            xyz[i, :, :] = _NAN
            sigma_out[i, :] = _NAN
            order_out[i, :] = _NOWHERE
            continue
        a = i // every
        z = np.empty(width, np.float32)
        _depths(known[a], depth[a], every, z)
        _points(z, ray_x[a], ray_y[a], every, xyz[i])
        _depths(known[a], sigma[a], every, sigma_out[i])
        _orders(known[a], order[a], every, order_out[i])
    return xyz, sigma_out, gray, order_out
