"""The weighted plane fit of :mod:`pipeline.attributes.normals`: links between pixels, sums over the window, normals.

A tile is processed row by row. The sums along all its rows stay in the second-level cache; a row's normals follow from
those of seven. Rows are a constant distance apart, so that the compiler needs no tests at run time for their overlap.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.prefetch import LINE, prefetch
from pipeline.common.tile_math import root

RADIUS = 3
"""Half width of the window, pixels."""
TILE, ROWS = 128, 64
"""Columns and rows of a tile: the sums of seven rows of it stay in the first-level cache, and two threads of one core
do not displace each other's (with 64 columns and 128 rows a second one brings nothing there)."""
_MARGIN = RADIUS + 1
_WIDE = TILE + 2 * _MARGIN
_HEIGHT = 2 * RADIUS + 1
_X, _Y, _Z, _W, _VARIANCE = range(0, 5 * _WIDE, _WIDE)  # offsets in a row of raw values
_RAW, _RING = 5 * _WIDE + _MARGIN, 4  # values of a row, with room for reads beyond the last pixel; rows in the ring
# Offsets in a row of sums: weight, weighted position, its first moment around the row's mean column, the pixel's own
# weight, links to the next row.
_SUM, _SUM_X, _SUM_Y, _SUM_Z, _MOMENT_X, _MOMENT_Y, _MOMENT_Z, _OWN, _DOWN, _OVER = range(0, 10 * TILE, TILE)
_SUMS = 10 * TILE
_UP3, _UP2, _UP1, _HERE, _DOWN1, _DOWN2, _DOWN3 = range(0, _HEIGHT * _SUMS, _SUMS)  # rows of a window
_AHEAD = 2
"""Rows that memory is requested ahead of their use."""
_NOISE_SQ = np.float32(4.0**2)
_LEAST = np.float32(5.0)
"""Least total weight of a fit, in weights of its own pixel."""
_FAR = np.float32(1e9)
"""Depth of an unknown pixel, mm: no known one is near it."""
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)
_ZERO, _ONE, _FOUR, _TINY, _NAN = np.float32(0), np.float32(1), np.float32(4), np.float32(1e-12), np.float32(np.nan)


@linked
def _load_row(
    xyz: Any, sigma: Any, height: int, width: int, y: int, first: int, reference: Any, unit: Any, raw: Any, new: int
) -> Any:
    """A row of a tile with its margins; weight and position are 0 where there is no point, and beyond the image.

    Args:
        xyz: (3 H W,); sigma: (H W,); y: row; first: column of the tile's margin.
        unit: mm^2, variance of a point of weight 1; raw: (_RING, _RAW), row ``new`` is written.

    Returns:
        Whether it has any point.
    """
    begin, end = max(-first, 0), min(width - first, _WIDE)
    inside = 0 <= y < height
    if end - begin < _WIDE or not inside:
        for j in range(5 * _WIDE):
            raw[new, j] = _FAR if _Z <= j < _W else _ZERO
    if not inside:
        return False
    total = _ZERO
    start = y * width + first + begin
    points, sigmas, inner = xyz[3 * start :], sigma[start:], raw[new, begin:]
    for j in range(end - begin):
        s, x, y_, z = sigmas[j], points[3 * j], points[3 * j + 1], points[3 * j + 2]
        known = (s == s) & (z == z)
        square = max(s * s, _TINY)
        inner[_X + j], inner[_Y + j] = x if known else _ZERO, y_ if known else _ZERO
        inner[_Z + j] = z - reference if known else _FAR
        weight = unit / square if known else _ZERO
        inner[_W + j], inner[_VARIANCE + j] = weight, _NOISE_SQ * square
        total += weight
    return total > _ZERO


@linked
def _link_columns(raw: Any, new: int, reach: Any, curved: Any, links: Any) -> None:
    """1 where a pixel and the next one are of one surface, and where those on both sides continue each other.

    Args:
        links: (2 _WIDE + 1,), number j is of pixels j and j + 1, number _WIDE + j of pixel j and its neighbours.
    """
    for j in range(_WIDE):
        x1, y1, z1 = raw[new, _X + j + 1], raw[new, _Y + j + 1], raw[new, _Z + j + 1]
        u, v, w = x1 - raw[new, _X + j], y1 - raw[new, _Y + j], z1 - raw[new, _Z + j]
        x, y, z = raw[new, _X + j + 2] - x1, raw[new, _Y + j + 2] - y1, raw[new, _Z + j + 2] - z1
        link = _ONE if u * u + v * v + w * w <= reach else _ZERO
        both = link if x * x + y * y + z * z <= reach else _ZERO
        x, y, z = x - u, y - v, z - w
        noise = _FOUR * raw[new, _VARIANCE + j + 1] + (raw[new, _VARIANCE + j] + raw[new, _VARIANCE + j + 2])
        links[j] = link
        links[_WIDE + 1 + j] = both if x * x + y * y + z * z <= curved + noise else _ZERO


@linked
def _sum_row(raw: Any, new: int, links: Any, sums: Any, at: int) -> None:
    """Weighted sums along a row over the pixels of each pixel's surface, RADIUS to both sides.

    A first moment 1 a + 2 b + 3 c is (a + b + c) + (b + c) + c: the sums on the way to the total give it.

    Args:
        sums: flat; at: where the row begins in it, written.
    """
    row = sums[at:]
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
        n = w + (p1 + q1)
        mean = ((p1 - q1) + (p2 - q2) + (a3 - b3)) / (n if n > _ZERO else _ONE)
        row[_OWN + j], row[_SUM + j] = w, n
        p3, q3 = a3 * raw[new, _X + c + 3], b3 * raw[new, _X + c - 3]
        p2, q2 = p3 + a2 * raw[new, _X + c + 2], q3 + b2 * raw[new, _X + c - 2]
        p1, q1 = p2 + a1 * raw[new, _X + c + 1], q2 + b1 * raw[new, _X + c - 1]
        total = w * raw[new, _X + c] + (p1 + q1)
        row[_SUM_X + j], row[_MOMENT_X + j] = total, (p1 - q1) + (p2 - q2) + (p3 - q3) - mean * total
        p3, q3 = a3 * raw[new, _Y + c + 3], b3 * raw[new, _Y + c - 3]
        p2, q2 = p3 + a2 * raw[new, _Y + c + 2], q3 + b2 * raw[new, _Y + c - 2]
        p1, q1 = p2 + a1 * raw[new, _Y + c + 1], q2 + b1 * raw[new, _Y + c - 1]
        total = w * raw[new, _Y + c] + (p1 + q1)
        row[_SUM_Y + j], row[_MOMENT_Y + j] = total, (p1 - q1) + (p2 - q2) + (p3 - q3) - mean * total
        p3, q3 = a3 * raw[new, _Z + c + 3], b3 * raw[new, _Z + c - 3]
        p2, q2 = p3 + a2 * raw[new, _Z + c + 2], q3 + b2 * raw[new, _Z + c - 2]
        p1, q1 = p2 + a1 * raw[new, _Z + c + 1], q2 + b1 * raw[new, _Z + c - 1]
        total = w * raw[new, _Z + c] + (p1 + q1)
        row[_SUM_Z + j], row[_MOMENT_Z + j] = total, (p1 - q1) + (p2 - q2) + (p3 - q3) - mean * total


@linked
def _link_rows(raw: Any, k: int, reach: Any, curved: Any, sums: Any) -> None:
    """Links of a row to the next one, and whether it continues from the row before to the next one.

    Args:
        k: number of the next row, up to which raw values are known; sums: links of the row before it are written.
    """
    above, here, below = (k - 2) % _RING, (k - 1) % _RING, k % _RING
    rows = sums[(k - 2) * _SUMS :]
    for j in range(TILE):
        c = j + _MARGIN
        x0, y0, z0 = raw[here, _X + c], raw[here, _Y + c], raw[here, _Z + c]
        x, y, z = raw[below, _X + c] - x0, raw[below, _Y + c] - y0, raw[below, _Z + c] - z0
        link = _ONE if x * x + y * y + z * z <= reach else _ZERO
        x, y, z = x - (x0 - raw[above, _X + c]), y - (y0 - raw[above, _Y + c]), z - (z0 - raw[above, _Z + c])
        noise = _FOUR * raw[here, _VARIANCE + c] + (raw[above, _VARIANCE + c] + raw[below, _VARIANCE + c])
        rows[_SUMS + _DOWN + j] = link
        rows[_SUMS + _OVER + j] = link * rows[_DOWN + j] if x * x + y * y + z * z <= curved + noise else _ZERO


@inline
def _combine(rows: Any, k: int, above: Any, here: Any, below: Any) -> Any:
    """Linear combination of an element of seven rows."""
    (a1, a2, a3), (b1, b2, b3) = below, above
    down = a1 * rows[k + _DOWN1] + a2 * rows[k + _DOWN2] + a3 * rows[k + _DOWN3]
    return here * rows[k + _HERE] + b1 * rows[k + _UP1] + b2 * rows[k + _UP2] + b3 * rows[k + _UP3] + down


@linked
def _fit_row(sums: Any, at: int, count: int, out: Any) -> None:
    """Normals of a row from the sums of seven.

    Args:
        at: where the first of the seven rows begins; count: of pixels; out: flat, from the row's first pixel on.
    """
    rows = sums[at:]
    for j in range(count):
        a1, b1 = rows[_HERE + _DOWN + j], rows[_UP1 + _DOWN + j]
        a2, b2 = a1 * rows[_DOWN1 + _OVER + j], b1 * rows[_UP1 + _OVER + j]
        a3, b3 = a2 * rows[_DOWN2 + _OVER + j], b2 * rows[_UP2 + _OVER + j]
        above, below = (b1, b2, b3), (a1, a2, a3)
        xu = _combine(rows, _MOMENT_X + j, above, _ONE, below)
        yu = _combine(rows, _MOMENT_Y + j, above, _ONE, below)
        zu = _combine(rows, _MOMENT_Z + j, above, _ONE, below)
        k = _SUM + j
        p3, q3 = a3 * rows[k + _DOWN3], b3 * rows[k + _UP3]
        p2, q2 = p3 + a2 * rows[k + _DOWN2], q3 + b2 * rows[k + _UP2]
        p1, q1 = p2 + a1 * rows[k + _DOWN1], q2 + b1 * rows[k + _UP1]
        n, v = rows[k + _HERE] + (p1 + q1), (p1 - q1) + (p2 - q2) + (p3 - q3)
        # Rows count with their distance from the mean row v / n, times n.
        up, down = -n - v, n - v
        above, below = (
            (b1 * up, b2 * (up - n), b3 * (up - (n + n))),
            (a1 * down, a2 * (down + n), a3 * (down + (n + n))),
        )
        xv = _combine(rows, _SUM_X + j, above, -v, below)
        yv = _combine(rows, _SUM_Y + j, above, -v, below)
        zv = _combine(rows, _SUM_Z + j, above, -v, below)
        x, y, z = yv * zu - zv * yu, zv * xu - xv * zu, xv * yu - yv * xu
        w, square = rows[_HERE + _OWN + j], x * x + y * y + z * z
        scale = _ONE / root(square) if (w > _ZERO) & (n >= _LEAST * w) & (square > _ZERO) else _NAN
        m = _3 * np.uint64(j)
        out[m], out[m + _1], out[m + _2] = scale * x, scale * y, scale * z


@inline
def _fill(row: Any, count: int, value: Any) -> None:
    for j in range(count):
        row[j] = value


@parallel_allocating
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
    raw, links = np.zeros((_RING, _RAW), np.float32), np.zeros(2 * _WIDE + 1, np.float32)
    sums, known = np.empty((high - low + _HEIGHT) * _SUMS, np.float32), np.zeros(_RING, np.bool_)
    _fill(sums, _SUMS, _ZERO)  # the row before the first one is linked to none
    for y in range(low - RADIUS, high + RADIUS):
        k = y - low + RADIUS + 1
        if y + _AHEAD < height:
            for j in range(0, 3 * TILE, LINE // 4):
                prefetch(xyz, 3 * ((y + _AHEAD) * width + left) + j)
            for j in range(0, TILE, LINE // 4):
                prefetch(sigma, (y + _AHEAD) * width + left + j)
        new = k % _RING
        known[new] = _load_row(xyz, flat, height, width, y, left - _MARGIN, reference, unit, raw, new)
        if known[new]:
            _link_columns(raw, new, reach, curved, links)
            _sum_row(raw, new, links, sums, k * _SUMS)
        else:
            _fill(sums[k * _SUMS :], _DOWN, _ZERO)
        if k > 1:
            _link_rows(raw, k, reach, curved, sums)
        if y < low + RADIUS:
            continue
        row = out[3 * ((y - RADIUS) * width + left) :]
        if known[(k - RADIUS) % _RING]:
            _fit_row(sums, (k - 2 * RADIUS) * _SUMS, count, row)
        else:
            _fill(row, 3 * count, _NAN)
