"""Downsampling by n x n: the weighted mean of the points of a block that lie on one surface.

Weights are 1 / sigma^2. The mean of points of a plane lies on the plane. Points of other surfaces in the block do not
count: a mean over a step would lie in the air.

Blocks are processed together: each pixel of a block has a row of its own with that pixel of all blocks, so that
all arithmetic runs along rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, linked, serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import root
from pipeline.filter.cloud.block_rows import BLOCKS, LONGEST, SPACING, deal, split
from pipeline.filter.cloud.surface_tangent import NEVER, ON_PLANE, slope

# Offsets in the scratch array: points that count, measured ones, those on the best plane so far, and on that of a
# candidate; slopes of the candidate's plane and their variances.
_CANDIDATES, _MEASURED, _MOST, _COUNT, _X, _X_NOISE, _Y, _Y_NOISE = range(0, 8 * BLOCKS, BLOCKS)
# The best candidate's inverse depth, its variance, its plane as above, its place in the block; weighted sums.
_BEST, _NOISE, _BEST_X, _BEST_XN, _BEST_Y, _BEST_YN, _COLUMN, _ROW, _SX, _SY, _SZ, _WEIGHT = range(
    8 * BLOCKS, 20 * BLOCKS, BLOCKS
)
_SCRATCH = 20 * BLOCKS
_ZERO, _ONE, _TWO, _NAN = np.float32(0), np.float32(1), np.float32(2), np.float32(np.nan)
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)


@linked
def _count_points(planes: Any, q: Any, filled: Any, s: Any) -> None:
    """Count a pixel of each block; ``filled``: number of its row of marks in ``planes``, 1 where interpolated."""
    for j in range(BLOCKS):
        value = planes[q + np.uint64(j)]
        s[_CANDIDATES + j] += _ONE if value == value else _ZERO
        s[_MEASURED + j] += _ONE - planes[filled + np.uint64(j)] if value == value else _ZERO


@linked
def _omit_filled(planes: Any, q: Any, filled: Any, counted: Any, s: Any) -> None:
    """Inverse depth of a pixel of each block, NaN where it does not count; to row ``counted``."""
    for j in range(BLOCKS):
        use = (planes[filled + np.uint64(j)] == _ZERO) | (s[_MEASURED + j] == _ZERO)
        planes[counted + np.uint64(j)] = planes[q + np.uint64(j)] if use else _NAN


@linked
def _tangents(planes: Any, here: Any, left: Any, right: Any, up: Any, down: Any, noise: Any, s: Any) -> None:
    """Tangent planes at a pixel of each block; the arguments are the rows' numbers in ``planes``."""
    for j in range(BLOCKS):
        k = np.uint64(j)
        middle, variance = planes[here + k], planes[noise + k]
        x, x_noise = slope(planes[left + k], middle, planes[right + k], variance)
        y, y_noise = slope(planes[up + k], middle, planes[down + k], variance)
        s[_X + j], s[_X_NOISE + j] = x if x == x else _ZERO, x_noise if x == x else NEVER
        s[_Y + j], s[_Y_NOISE + j] = y if y == y else _ZERO, y_noise if y == y else NEVER
        s[_COUNT + j] = _ZERO


@inline
def _on(other: Any, other_noise: Any, here: Any, noise: Any, x: Any, x_noise: Any, y: Any, y_noise: Any) -> bool:
    """Whether a pixel is on a tangent plane: x, y are the slopes times its offset, with their variances."""
    off = other - here - x - y
    return off * off <= ON_PLANE * (other_noise + noise + x_noise + y_noise)


@serial
def _count(planes: Any, q: Any, noise: Any, other: Any, other_noise: Any, x: Any, y: Any, s: Any) -> None:
    """Add 1 where a pixel of a block is on the candidate's plane; x, y: its offset from the candidate, float32."""
    for j in range(BLOCKS):
        k = np.uint64(j)
        on = _on(
            planes[other + k], planes[other_noise + k], planes[q + k], planes[noise + k], s[_X + j] * x,
            s[_X_NOISE + j] * x * x, s[_Y + j] * y, s[_Y_NOISE + j] * y * y,
        )  # fmt: skip
        s[_COUNT + j] += _ONE if on else _ZERO


@serial
def _choose(planes: Any, counted: Any, noise: Any, x: Any, y: Any, s: Any) -> Any:
    """Keep the candidate where it is the best, and return how many blocks have no plane of more than half so far."""
    open_ = 0
    for j in range(BLOCKS):
        k = np.uint64(j)
        q, count, most, candidates = planes[counted + k], s[_COUNT + j], s[_MOST + j], s[_CANDIDATES + j]
        better = (q == q) & (count > most) & (_TWO * most <= candidates)
        s[_BEST + j], s[_NOISE + j] = q if better else s[_BEST + j], planes[noise + k] if better else s[_NOISE + j]
        s[_BEST_X + j] = s[_X + j] if better else s[_BEST_X + j]
        s[_BEST_XN + j] = s[_X_NOISE + j] if better else s[_BEST_XN + j]
        s[_BEST_Y + j] = s[_Y + j] if better else s[_BEST_Y + j]
        s[_BEST_YN + j] = s[_Y_NOISE + j] if better else s[_BEST_YN + j]
        s[_COLUMN + j], s[_ROW + j] = x if better else s[_COLUMN + j], y if better else s[_ROW + j]
        most = count if better else most
        s[_MOST + j] = most
        open_ += 1 if (_TWO * most <= candidates) & (candidates > _ZERO) else 0
    return open_


@serial
def _add(
    planes: Any, other: Any, other_noise: Any, x: Any, y: Any, points: Any, at: Any, apart: Any, origin: Any, s: Any
) -> None:
    """Add a pixel of each block to the weighted sums where it is on the chosen plane.

    Args:
        x, y: the pixel's place in the block.
        points: rows of x, y, z and sigma, the first from number ``at`` on, ``apart`` from each other.
        origin: x, y, z of the chosen pixel, BLOCKS apart.
    """
    for j in range(BLOCKS):
        k = np.uint64(j)
        dx, dy = x - s[_COLUMN + j], y - s[_ROW + j]
        on = _on(
            planes[other + k], planes[other_noise + k], s[_BEST + j], s[_NOISE + j], s[_BEST_X + j] * dx,
            s[_BEST_XN + j] * dx * dx, s[_BEST_Y + j] * dy, s[_BEST_YN + j] * dy * dy,
        )  # fmt: skip
        m = at + k
        px, py, pz, sigma = points[m], points[m + apart], points[m + _2 * apart], points[m + _3 * apart]
        w = _ONE / (sigma * sigma)
        px, py, pz = px - origin[j], py - origin[BLOCKS + j], pz - origin[2 * BLOCKS + j]
        # Unknown values must not enter the products.
        w, px, py, pz = w if on else _ZERO, px if on else _ZERO, py if on else _ZERO, pz if on else _ZERO
        s[_SX + j] += w * px
        s[_SY + j] += w * py
        s[_SZ + j] += w * pz
        s[_WEIGHT + j] += w
        s[_COUNT + j] += _ONE if on else _ZERO


@parallel_allocating
def downsample(
    a: int, n: int, q: Any, variance: Any, pitch: Any, points: Any, sigmas: Any, filled: Any, inflation: Any, xyz: Any,
    sigma: Any, interpolated: Any,
) -> None:  # fmt: skip
    """Reduce a row of blocks.

    The surface of a block is that of the pixel on whose tangent plane most of the block's points lie. Interpolated
    points count only where a block has no others.

    Args:
        n: rows and columns of a block; q, variance: flat float32 of
            :func:`pipeline.filter.cloud.surface_tangent.inverse_depth`, with a margin of n and rows ``pitch`` apart.
        points: (3 H W,), sigmas: (H, W), float32; filled: (H, W) uint8, 1 where interpolated, or (0, 0).
        inflation: (n n + 1) float32, variance of the mean of so many points over that with independent noise.
        xyz: (h, 3 w), sigma: (h, w), float32, interpolated: (h, w) uint8, written; h, w = H / n, W / n rounded down.
    """
    width = sigma.shape[1]
    first, size = np.uint64((n + 2) * n * SPACING), np.uint64(n * n * SPACING)
    flat_sigma, rows, at = sigmas.reshape(sigmas.size), np.empty(3 * LONGEST, np.float32), np.uint64(0)
    planes = np.zeros((n + 2 + 3 * n) * n * SPACING, np.float32)
    s, member, origin = (
        np.empty(_SCRATCH, np.float32), np.ones(4 * n * SPACING, np.float32), np.zeros(3 * BLOCKS, np.float32)
    )  # fmt: skip
    for left in range(0, width, BLOCKS):
        count = min(BLOCKS, width - left)
        s[:] = _ZERO
        # Rows of the blocks' pixels in ``planes``: inverse depth with the blocks' neighbours above, below and beside.
        for k in range(n + 2):
            at = np.uint64(n * a + k + n - 1) * pitch + np.uint64(n * left)
            deal(q, at, n, BLOCKS + 2, planes, np.uint64(k * n * SPACING))
        for k in range(n):
            at = np.uint64(n * a + k + n) * pitch + np.uint64(n * left + n)
            deal(variance, at, n, BLOCKS, planes, first + np.uint64(k * n * SPACING))
        for k in range(n * n):
            here, marks = _row(k, n) + _1, first + size + np.uint64(k * SPACING)
            if filled.shape[0] > 0:
                for j in range(count):
                    planes[marks + np.uint64(j)] = np.float32(filled[n * a + k // n, n * (left + j) + k % n])
            _count_points(planes, here, marks, s)
        for k in range(n * n):
            marks = first + size + np.uint64(k * SPACING)
            _omit_filled(planes, _row(k, n) + _1, marks, marks + size, s)
        for j in range(BLOCKS):
            if j < count:
                interpolated[a, left + j] = np.uint8((s[_CANDIDATES + j] > _ZERO) & (s[_MEASURED + j] == _ZERO))
            s[_CANDIDATES + j] = s[_MEASURED + j] if s[_MEASURED + j] > _ZERO else s[_CANDIDATES + j]
        for k in range(n * n):
            here, noise = _row(k, n) + _1, first + np.uint64(k * SPACING)
            before = here - np.uint64(SPACING) if k % n > 0 else _row(k + n - 1, n)
            after = here + np.uint64(SPACING) if k % n < n - 1 else _row(k - n + 1, n) + _2
            line = np.uint64(n * SPACING)
            _tangents(planes, here, before, after, here - line, here + line, noise, s)
            for m in range(n * n):
                other = first + np.uint64(m * SPACING)
                _count(
                    planes, here, noise, other + size + size, other, np.float32(m % n - k % n),
                    np.float32(m // n - k // n), s,
                )  # fmt: skip
            if _choose(planes, noise + size + size, noise, np.float32(k % n), np.float32(k // n), s) == 0:
                break
        for j in range(BLOCKS):
            s[_COUNT + j] = _ZERO
        for j in range(count):
            k = 3 * ((n * a + int(s[_ROW + j])) * sigmas.shape[1] + n * (left + j) + int(s[_COLUMN + j]))
            origin[j], origin[BLOCKS + j], origin[2 * BLOCKS + j] = points[k], points[k + 1], points[k + 2]
        for k in range(n * n):
            if k % n == 0:
                at = np.uint64((n * a + k // n) * sigmas.shape[1] + n * left)
                split(points, at, n * count, rows)
                for axis in range(3):
                    deal(rows, np.uint64(axis * LONGEST), n, count, member, np.uint64(axis * n * SPACING))
                deal(flat_sigma, at, n, count, member, np.uint64(3 * n * SPACING))
            noise = first + np.uint64(k * SPACING)
            _add(
                planes, noise + size + size, noise, np.float32(k % n), np.float32(k // n), member,
                np.uint64(k % n * SPACING), np.uint64(n * SPACING), origin, s,
            )  # fmt: skip
        means, sigma_row = xyz[a, 3 * left :], sigma[a, left:]
        for j in range(count):
            scale = _ONE / s[_WEIGHT + j] if s[_MOST + j] > _ZERO else _NAN
            means[3 * j] = origin[j] + s[_SX + j] * scale
            means[3 * j + 1] = origin[BLOCKS + j] + s[_SY + j] * scale
            means[3 * j + 2] = origin[2 * BLOCKS + j] + s[_SZ + j] * scale
            s[_WEIGHT + j] = scale
        for j in range(count):
            sigma_row[j] = root(inflation[int(s[_COUNT + j])] * s[_WEIGHT + j])


@inline
def _row(k: int, n: int) -> Any:
    """Number of the row of inverse depths of pixel k of the blocks; it begins with the block before the first."""
    return np.uint64((k + n) * SPACING)
