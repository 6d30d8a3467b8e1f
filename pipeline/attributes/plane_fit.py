"""The weighted plane fit of :mod:`pipeline.attributes.normals`: links between pixels, sums over the window, normals.

A tile is processed row by row. The sums along its last seven rows stay in a ring; a row's normals follow from them. The
rings are passed whole, with the number of the row: a slice of an array costs as much as several pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, serial
from pipeline.common.parallel_for import parallel
from pipeline.common.prefetch import LINE, prefetch
from pipeline.common.tile_math import root

RADIUS = 3
"""Half width of the window, pixels."""
TILE, ROWS = 64, 128
"""Columns and rows of a tile: the sums of seven rows of it stay in the first-level cache."""
_MARGIN = RADIUS + 1
_WIDE = TILE + 2 * _MARGIN
_HEIGHT = 2 * RADIUS + 1
_X, _Y, _Z, _W, _VARIANCE = range(0, 5 * _WIDE, _WIDE)  # offsets in a row of raw values
_RAW = 5 * _WIDE
# Offsets in a row of sums: weight and its first moment, weighted position and its first moment, the pixel's own weight,
# links to the next row.
_SUM, _MOMENT, _SUM_X, _SUM_Y, _SUM_Z, _MOMENT_X, _MOMENT_Y, _MOMENT_Z, _OWN, _DOWN, _OVER = range(0, 11 * TILE, TILE)
_SUMS = 11 * TILE
_AHEAD = 2
"""Rows that memory is requested ahead of their use."""
_NOISE_SQ = np.float32(4.0**2)
_LEAST = np.float32(5.0)
"""Least total weight of a fit, in weights of its own pixel."""
_FAR = np.float32(1e9)
"""Depth of an unknown pixel, mm: no known one is near it."""
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)
_ZERO, _ONE, _FOUR, _TINY, _NAN = np.float32(0), np.float32(1), np.float32(4), np.float32(1e-12), np.float32(np.nan)


@serial
def _load_row(
    xyz: Any, sigma: Any, height: int, width: int, y: int, first: int, reference: Any, unit: Any, raw: Any, new: int
) -> None:
    """A row of a tile with its margins; weight and position are 0 where there is no point, and beyond the image.

    Args:
        xyz: (3 H W,); sigma: (H W,); y: row; first: column of the tile's margin.
        unit: mm^2, variance of a point of weight 1; raw: (3, _RAW), row ``new`` is written.
    """
    begin, end = max(-first, 0), min(width - first, _WIDE)
    inside = 0 <= y < height
    if end - begin < _WIDE or not inside:
        for j in range(_RAW):
            raw[new, j] = _FAR if _Z <= j < _W else _ZERO
    if not inside:
        return
    start = y * width + first + begin
    points, sigmas, inner = xyz[3 * start :], sigma[start:], raw[new, begin:]
    for j in range(end - begin):
        s, x, y_, z = sigmas[j], points[3 * j], points[3 * j + 1], points[3 * j + 2]
        known = (s == s) & (z == z)
        square = max(s * s, _TINY)
        inner[_X + j], inner[_Y + j] = x if known else _ZERO, y_ if known else _ZERO
        inner[_Z + j] = z - reference if known else _FAR
        inner[_W + j] = unit / square if known else _ZERO
        inner[_VARIANCE + j] = _NOISE_SQ * square


@serial
def _link_columns(raw: Any, new: int, reach: Any, curved: Any, links: Any) -> None:
    """1 where a pixel and the next one are of one surface, and where those on both sides continue each other."""
    for j in range(_WIDE - 1):
        x, y, z = (
            raw[new, _X + j + 1] - raw[new, _X + j],
            raw[new, _Y + j + 1] - raw[new, _Y + j],
            raw[new, _Z + j + 1] - raw[new, _Z + j],
        )
        links[j] = _ONE if x * x + y * y + z * z <= reach else _ZERO
    for j in range(1, _WIDE - 1):
        x = raw[new, _X + j + 1] - raw[new, _X + j] - (raw[new, _X + j] - raw[new, _X + j - 1])
        y = raw[new, _Y + j + 1] - raw[new, _Y + j] - (raw[new, _Y + j] - raw[new, _Y + j - 1])
        z = raw[new, _Z + j + 1] - raw[new, _Z + j] - (raw[new, _Z + j] - raw[new, _Z + j - 1])
        noise = _FOUR * raw[new, _VARIANCE + j] + (raw[new, _VARIANCE + j - 1] + raw[new, _VARIANCE + j + 1])
        links[_WIDE + j] = links[j - 1] * links[j] if x * x + y * y + z * z <= curved + noise else _ZERO


@serial
def _sum_row(raw: Any, new: int, links: Any, sums: Any, now: int) -> None:
    """Weighted sums along a row over the pixels of each pixel's surface, RADIUS to both sides.

    A first moment 1 a + 2 b + 3 c is (a + b + c) + (b + c) + c: the sums on the way to the total give it.
    """
    for j in range(TILE):
        c = j + _MARGIN
        w = raw[new, _W + c]
        ahead, back = links[c], links[c - 1]
        a1, b1 = ahead * raw[new, _W + c + 1], back * raw[new, _W + c - 1]
        ahead, back = ahead * links[_WIDE + c + 1], back * links[_WIDE + c - 1]
        a2, b2 = ahead * raw[new, _W + c + 2], back * raw[new, _W + c - 2]
        ahead, back = ahead * links[_WIDE + c + 2], back * links[_WIDE + c - 2]
        a3, b3 = ahead * raw[new, _W + c + 3], back * raw[new, _W + c - 3]
        p2, q2 = a3 + a2, b3 + b2
        p1, q1 = p2 + a1, q2 + b1
        sums[now, _OWN + j], sums[now, _SUM + j], sums[now, _MOMENT + j] = (
            w,
            w + (p1 + q1),
            (p1 - q1) + (p2 - q2) + (a3 - b3),
        )
        p3, q3 = a3 * raw[new, _X + c + 3], b3 * raw[new, _X + c - 3]
        p2, q2 = p3 + a2 * raw[new, _X + c + 2], q3 + b2 * raw[new, _X + c - 2]
        p1, q1 = p2 + a1 * raw[new, _X + c + 1], q2 + b1 * raw[new, _X + c - 1]
        sums[now, _SUM_X + j], sums[now, _MOMENT_X + j] = (
            w * raw[new, _X + c] + (p1 + q1),
            (p1 - q1) + (p2 - q2) + (p3 - q3),
        )
        p3, q3 = a3 * raw[new, _Y + c + 3], b3 * raw[new, _Y + c - 3]
        p2, q2 = p3 + a2 * raw[new, _Y + c + 2], q3 + b2 * raw[new, _Y + c - 2]
        p1, q1 = p2 + a1 * raw[new, _Y + c + 1], q2 + b1 * raw[new, _Y + c - 1]
        sums[now, _SUM_Y + j], sums[now, _MOMENT_Y + j] = (
            w * raw[new, _Y + c] + (p1 + q1),
            (p1 - q1) + (p2 - q2) + (p3 - q3),
        )
        p3, q3 = a3 * raw[new, _Z + c + 3], b3 * raw[new, _Z + c - 3]
        p2, q2 = p3 + a2 * raw[new, _Z + c + 2], q3 + b2 * raw[new, _Z + c - 2]
        p1, q1 = p2 + a1 * raw[new, _Z + c + 1], q2 + b1 * raw[new, _Z + c - 1]
        sums[now, _SUM_Z + j], sums[now, _MOMENT_Z + j] = (
            w * raw[new, _Z + c] + (p1 + q1),
            (p1 - q1) + (p2 - q2) + (p3 - q3),
        )


@serial
def _link_rows(raw: Any, k: int, reach: Any, curved: Any, sums: Any) -> None:
    """Links of a row to the next one, and whether it continues from the row before to the next one.

    Args:
        k: number of the next row, from which both rings continue; sums: links of the row before it are written.
    """
    above, here, below = (k - 2) % 3, (k - 1) % 3, k % 3
    before, now = (k - 2) % _HEIGHT, (k - 1) % _HEIGHT
    for j in range(TILE):
        c = j + _MARGIN
        x0, y0, z0 = raw[here, _X + c], raw[here, _Y + c], raw[here, _Z + c]
        x, y, z = raw[below, _X + c] - x0, raw[below, _Y + c] - y0, raw[below, _Z + c] - z0
        link = _ONE if x * x + y * y + z * z <= reach else _ZERO
        x, y, z = x - (x0 - raw[above, _X + c]), y - (y0 - raw[above, _Y + c]), z - (z0 - raw[above, _Z + c])
        noise = _FOUR * raw[here, _VARIANCE + c] + (raw[above, _VARIANCE + c] + raw[below, _VARIANCE + c])
        sums[now, _DOWN + j] = link
        sums[now, _OVER + j] = link * sums[before, _DOWN + j] if x * x + y * y + z * z <= curved + noise else _ZERO


@inline
def _sum_and_moment(
    sums: Any, rows: Any, k: int, a1: Any, a2: Any, a3: Any, b1: Any, b2: Any, b3: Any
) -> Any:  # fmt: skip
    """Sum of an element over seven rows with their masks, and its first moment; see :func:`_sum_row`."""
    up3, up2, up1, here, down1, down2, down3 = rows
    p3, q3 = a3 * sums[down3, k], b3 * sums[up3, k]
    p2, q2 = p3 + a2 * sums[down2, k], q3 + b2 * sums[up2, k]
    p1, q1 = p2 + a1 * sums[down1, k], q2 + b1 * sums[up1, k]
    return sums[here, k] + (p1 + q1), (p1 - q1) + (p2 - q2) + (p3 - q3)


@inline
def _sum(sums: Any, rows: Any, k: int, a1: Any, a2: Any, a3: Any, b1: Any, b2: Any, b3: Any) -> Any:
    """Sum of an element over seven rows with their masks."""
    up3, up2, up1, here, down1, down2, down3 = rows
    below = a1 * sums[down1, k] + a2 * sums[down2, k] + a3 * sums[down3, k]
    return sums[here, k] + b1 * sums[up1, k] + b2 * sums[up2, k] + b3 * sums[up3, k] + below


@serial
def _fit_row(sums: Any, k: int, out: Any) -> None:
    """Normals (3 TILE,) of a row from the sums of seven, the last of which is number ``k`` of the ring."""
    rows = (
        (k - 6) % _HEIGHT, (k - 5) % _HEIGHT, (k - 4) % _HEIGHT, (k - 3) % _HEIGHT, (k - 2) % _HEIGHT,
        (k - 1) % _HEIGHT, k % _HEIGHT,
    )  # fmt: skip
    _, up2, up1, here, down1, down2, _ = rows
    for j in range(TILE):
        a1, b1 = sums[here, _DOWN + j], sums[up1, _DOWN + j]
        a2, b2 = a1 * sums[down1, _OVER + j], b1 * sums[up1, _OVER + j]
        a3, b3 = a2 * sums[down2, _OVER + j], b2 * sums[up2, _OVER + j]
        n, v = _sum_and_moment(sums, rows, _SUM + j, a1, a2, a3, b1, b2, b3)
        u = _sum(sums, rows, _MOMENT + j, a1, a2, a3, b1, b2, b3)
        x, xv = _sum_and_moment(sums, rows, _SUM_X + j, a1, a2, a3, b1, b2, b3)
        y, yv = _sum_and_moment(sums, rows, _SUM_Y + j, a1, a2, a3, b1, b2, b3)
        z, zv = _sum_and_moment(sums, rows, _SUM_Z + j, a1, a2, a3, b1, b2, b3)
        xu = n * _sum(sums, rows, _MOMENT_X + j, a1, a2, a3, b1, b2, b3) - u * x
        yu = n * _sum(sums, rows, _MOMENT_Y + j, a1, a2, a3, b1, b2, b3) - u * y
        zu = n * _sum(sums, rows, _MOMENT_Z + j, a1, a2, a3, b1, b2, b3) - u * z
        xv, yv, zv = n * xv - v * x, n * yv - v * y, n * zv - v * z
        out[j], out[TILE + j], out[2 * TILE + j] = yv * zu - zv * yu, zv * xu - xv * zu, xv * yu - yv * xu
        w = sums[here, _OWN + j]
        out[3 * TILE + j] = _ONE if (w > _ZERO) & (n >= _LEAST * w) else _ZERO
    for j in range(TILE):
        x, y, z = out[j], out[TILE + j], out[2 * TILE + j]
        square = x * x + y * y + z * z
        scale = root(out[3 * TILE + j] / square) if square * out[3 * TILE + j] > _ZERO else _NAN
        out[j], out[TILE + j], out[2 * TILE + j] = scale * x, scale * y, scale * z


@parallel
def fit_normals(
    tile: int, xyz: Any, sigma: Any, tiles: int, reference: Any, unit: Any, reach: Any, curved: Any, out: Any
) -> None:  # fmt: skip
    """Normals of one tile of TILE columns and ROWS rows.

    Args:
        xyz: (3 H W,) float32; sigma: (H, W) float32; tiles: number of tiles in a row of them.
        reference: depth that is subtracted, against rounding; unit: mm^2, variance of a point of weight 1.
        reach: largest squared distance of neighbours, mm^2; curved: largest squared second difference without noise,
            mm^2; out: (3 H W,) float32, result.
    """
    height, width = sigma.shape
    flat = sigma.reshape(height * width)
    low, left = tile // tiles * ROWS, tile % tiles * TILE
    high, count = min(low + ROWS, height), min(TILE, width - left)
    raw, sums = np.zeros((3, _RAW), np.float32), np.zeros((_HEIGHT, _SUMS), np.float32)
    links, row = np.zeros(2 * _WIDE, np.float32), np.zeros(4 * TILE, np.float32)
    for y in range(low - RADIUS - 1, high + RADIUS):
        k = y + _HEIGHT
        if y + _AHEAD < height:
            for j in range(0, 3 * TILE, LINE // 4):
                prefetch(xyz, 3 * ((y + _AHEAD) * width + left) + j)
                prefetch(out, 3 * ((y + _AHEAD - RADIUS) * width + left) + j)
            for j in range(0, TILE, LINE // 4):
                prefetch(sigma, (y + _AHEAD) * width + left + j)
        _load_row(xyz, flat, height, width, y, left - _MARGIN, reference, unit, raw, k % 3)
        _link_columns(raw, k % 3, reach, curved, links)
        _sum_row(raw, k % 3, links, sums, k % _HEIGHT)
        _link_rows(raw, k, reach, curved, sums)
        if y < low + RADIUS:
            continue
        _fit_row(sums, k, row)
        start = np.uint64((y - RADIUS) * width + left)
        for j in range(count):
            m = _3 * (start + np.uint64(j))
            out[m], out[m + _1], out[m + _2] = row[j], row[TILE + j], row[2 * TILE + j]
