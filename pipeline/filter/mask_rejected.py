"""Rejected points are set to unknown in the planes of the cloud."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked
from pipeline.common.parallel_for import parallel

_NAN = np.float32(np.nan)
_NOWHERE = np.int16(-1)


@linked
def _mask_row(valid: Any, order: Any, near: Any, far: Any, xyz: Any, sigma: Any, order_out: Any) -> None:
    for j in range(sigma.shape[0]):
        x, y, z = xyz[j, 0], xyz[j, 1], xyz[j, 2]
        known = (valid[j] != 0) & (z >= near) & (z <= far)
        xyz[j, 0], xyz[j, 1], xyz[j, 2] = x if known else _NAN, y if known else _NAN, z if known else _NAN
        sigma[j] = sigma[j] if known else _NAN
        order_out[j] = order[j] if known else _NOWHERE


@parallel
def mask_rejected(
    i: int, valid: Any, order: Any, stride: int, near: Any, far: Any, xyz: Any, sigma: Any, order_out: Any
) -> None:
    """Set rejected points of the match, and those outside of the volume, to NaN and copy the orders of the others.

    Args:
        valid: (h, w) uint8, 1 where a point is certain; order: (h, w) int16.
        stride: pixel (a, b) of those is the cloud's (every a, every b); pixels in between are unknown.
        near, far: float32, limits of the depth, mm.
        xyz: (H, W, 3), sigma: (H, W), float32, changed; order_out: (H, W) int16, written, -1 where unknown.
    """
    if i % stride != 0:
        xyz[i, :, :], sigma[i, :], order_out[i, :] = _NAN, _NAN, _NOWHERE
        return
    here, orders = valid[i // stride], order[i // stride]
    if stride == 1:
        _mask_row(here, orders, near, far, xyz[i], sigma[i], order_out[i])
        return
    for j in range(sigma.shape[1]):
        b, z = j // stride, xyz[i, j, 2]
        if j % stride == 0 and here[b] != 0 and near <= z <= far:
            order_out[i, j] = orders[b]
        else:
            xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2], sigma[i, j] = _NAN, _NAN, _NAN, _NAN
            order_out[i, j] = _NOWHERE


@parallel
def mask_unknown(a: int, known: Any, stride: int, xyz: Any, sigma: Any, order: Any) -> None:
    """Set the points that are 0 in ``known`` (h, w) uint8 to unknown; arguments else as of :func:`mask_rejected`."""
    i, some = stride * a, False
    for b in range(known.shape[1]):
        some |= (known[a, b] == 0) & (sigma[i, stride * b] == sigma[i, stride * b])
    if not some:
        return
    for b in range(known.shape[1]):
        if known[a, b] == 0:
            j = stride * b
            xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2], sigma[i, j] = _NAN, _NAN, _NAN, _NAN
            order[i, j] = _NOWHERE
