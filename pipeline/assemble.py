"""The cloud's planes from the located points and what the gates left of them, each written once."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange, serial

_NAN = np.float32(np.nan)
_NOWHERE = np.int16(-1)
_ZERO, _MOST = np.float32(0.0), np.float32(255.0)


@serial
def _depths(known: Any, depth: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        out[j] = depth[j] if known[j] != 0 else _NAN


@serial
def _points(z: Any, ray_x: Any, ray_y: Any, out: Any) -> None:
    for j in range(z.shape[0]):
        out[j, 0] = ray_x[j] * z[j]
        out[j, 1] = ray_y[j] * z[j]
        out[j, 2] = z[j]


@serial
def _orders(known: Any, order: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        out[j] = order[j] if known[j] != 0 else _NOWHERE


@serial
def _counts(mean: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        x = np.rint(mean[j])
        x = x if x > _ZERO else _ZERO
        out[j] = np.uint8(np.int32(x if x < _MOST else _MOST))


@parallel
def assemble(
    known: Any, depth: Any, sigma: Any, ray_x: Any, ray_y: Any, mean: Any, order: Any
) -> tuple[Any, Any, Any, Any]:
    """Points, their sigma, gray values and orders.

    Args:
        known: (H, W) uint8; depth, sigma: (H, W) float32 mm, read where known.
        ray_x, ray_y: (H, W) float32, ideal normalised points of the pixels.
        mean: (H, W) float32, counts; order: (H, W) int16.

    Returns:
        xyz (H, W, 3) float32 mm and sigma (H, W) float32 mm, NaN where unknown; gray (H, W) uint8, everywhere;
        order (H, W) int16, -1 where unknown.
    """
    height, width = known.shape
    xyz = np.empty((height, width, 3), np.float32)
    sigma_out = np.empty((height, width), np.float32)
    gray = np.empty((height, width), np.uint8)
    order_out = np.empty((height, width), np.int16)
    for i in prange(height):
        z = np.empty(width, np.float32)
        _depths(known[i], depth[i], z)
        _points(z, ray_x[i], ray_y[i], xyz[i])
        _depths(known[i], sigma[i], sigma_out[i])
        _orders(known[i], order[i], order_out[i])
        _counts(mean[i], gray[i])
    return xyz, sigma_out, gray, order_out
