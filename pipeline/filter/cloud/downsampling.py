"""Downsampling by n x n: the weighted mean of the points of a block that lie on one surface.

Weights are 1 / sigma^2. The mean of points of a plane lies on the plane. Points of other surfaces in the block do not
count: a mean over a step would lie in the air.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import parallel
from pipeline.filter.cloud.surface_tangent import on_plane, tangent

_NAN = np.float32(np.nan)


@parallel
def downsample(
    a: int, n: int, q: Any, variance: Any, points: Any, sigmas: Any, filled: Any, inflation: Any, xyz: Any, sigma: Any,
    interpolated: Any,
) -> None:  # fmt: skip
    """Reduce a row of blocks.

    The surface of a block is that of the pixel on whose tangent plane most of the block's points lie. Interpolated
    points count only where a block has no others.

    Args:
        n: rows and columns of a block; q, variance: (H, W) float32 of
            :func:`pipeline.filter.cloud.surface_tangent.inverse_depth`.
        points: (H, W, 3), sigmas: (H, W), float32; filled: (H, W) uint8, 1 where interpolated.
        inflation: (n n + 1) float32, variance of the mean of so many points over that with independent noise.
        xyz: (h, w, 3), sigma: (h, w), float32, interpolated: (h, w) uint8, written; h, w = H / n, W / n rounded down.
    """
    for b in range(sigma.shape[1]):
        measured, known = 0, 0
        for i in range(n * a, n * a + n):
            for j in range(n * b, n * b + n):
                if q[i, j] == q[i, j]:
                    known += 1
                    measured += int(filled[i, j] == 0)
        interpolated[a, b] = np.uint8((known > 0) & (measured == 0))
        most, best_i, best_j = 0, -1, -1
        candidates = measured if measured > 0 else known
        for k in range(n * n):
            i, j = n * a + k // n, n * b + k % n
            if 2 * most > candidates or q[i, j] != q[i, j] or (measured > 0 and filled[i, j] != 0):
                continue
            plane = tangent(q, variance, i, j)
            on = 0
            for m in range(n * n):
                y, x = m // n - k // n, m % n - k % n
                if (measured == 0 or filled[i + y, j + x] == 0) and on_plane(
                    q[i + y, j + x], variance[i + y, j + x], q[i, j], variance[i, j], plane, np.float32(x),
                    np.float32(y),
                ):  # fmt: skip
                    on += 1
            if on > most:
                most, best_i, best_j = on, i, j
        if most == 0:
            xyz[a, b, 0], xyz[a, b, 1], xyz[a, b, 2], sigma[a, b] = _NAN, _NAN, _NAN, _NAN
            continue
        plane = tangent(q, variance, best_i, best_j)
        x0, y0, z0 = points[best_i, best_j, 0], points[best_i, best_j, 1], points[best_i, best_j, 2]
        sx, sy, sz, weight, count = np.float32(0), np.float32(0), np.float32(0), np.float32(0), 0
        for i in range(n * a, n * a + n):
            for j in range(n * b, n * b + n):
                if (measured > 0 and filled[i, j] != 0) or not on_plane(
                    q[i, j], variance[i, j], q[best_i, best_j], variance[best_i, best_j], plane,
                    np.float32(j - best_j), np.float32(i - best_i),
                ):  # fmt: skip
                    continue
                w = np.float32(1) / (sigmas[i, j] * sigmas[i, j])
                sx += w * (points[i, j, 0] - x0)
                sy += w * (points[i, j, 1] - y0)
                sz += w * (points[i, j, 2] - z0)
                weight += w
                count += 1
        xyz[a, b, 0], xyz[a, b, 1], xyz[a, b, 2] = x0 + sx / weight, y0 + sy / weight, z0 + sz / weight
        sigma[a, b] = np.sqrt(inflation[count] / weight)
