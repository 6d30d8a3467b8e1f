"""Rejected points are set to unknown in the planes of the cloud, which the match has written."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import parallel

_NAN = np.float32(np.nan)
_NOWHERE = np.int16(-1)


@parallel
def mask_rejected(
    i: int, valid: Any, order: Any, stride: int, near: Any, far: Any, xyz: Any, sigma: Any, order_out: Any
) -> None:
    """Set rejected points, and those outside of the volume, to NaN and copy the orders of the others.

    Args:
        valid: (h, w) uint8, 1 where a point is certain; order: (h, w) int16.
        stride: pixel (a, b) of those is the cloud's (every a, every b); pixels in between are unknown.
        near, far: float32, limits of the depth, mm.
        xyz: (H, W, 3), sigma: (H, W), float32, changed; order_out: (H, W) int16, written, -1 where unknown.
    """
    width = sigma.shape[1]
    if stride != 1:
        order_out[i, :] = _NOWHERE
        if i % stride != 0:
            xyz[i, :, :], sigma[i, :] = _NAN, _NAN
            return
        for j in range(width):
            if j % stride != 0:
                xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2], sigma[i, j] = _NAN, _NAN, _NAN, _NAN
    a = i // stride
    here, orders = valid[a], order[a]
    if stride == 1:
        out = order_out[i]
        for j in range(width):
            one = orders[j]
            out[j] = one if here[j] != 0 else _NOWHERE
    for b in range(here.shape[0]):
        m = np.uint32(stride * b)
        z = xyz[i, m, 2]
        if here[b] == 0 or z < near or z > far:
            xyz[i, m, 0], xyz[i, m, 1], xyz[i, m, 2], sigma[i, m] = _NAN, _NAN, _NAN, _NAN
            order_out[i, m] = _NOWHERE
        elif stride != 1:
            order_out[i, m] = orders[b]
