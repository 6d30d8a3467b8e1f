"""Surface normals of an organised cloud, by a weighted fit of a plane around every point.

Around a pixel the position is fitted by ``p(u, v) = p0 + pu u + pv v`` over a window of 7 x 7 pixels (u to the right, v
down), weighted by 1 / sigma^2. The normal is ``pv x pu``, which points towards the camera because it sees the surface's
front, whatever rigid frame the points are in. With the weighted covariances ``bu, bv`` of position and pixel the
solution of the normal equations gives ``pu x pv = (bu x bv) / det``, so that their direction needs no solution at all.

Only pixels of the same surface take part: along the window's middle column, and from there along each row, pixels
follow each other until the position jumps, or until its second difference exceeds its noise (an edge between faces).
The sums are therefore separable: along the rows first, then over them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import serial
from pipeline.common.parallel_for import blocks, parallel
from pipeline.common.tile_math import root

F32 = NDArray[np.float32]

RADIUS = 3
"""Half width of the window, pixels."""
TILE, _ROWS = 128, 128
"""Columns and rows of a tile: what eight rows of it need stays in the first-level cache."""
_WIDE = TILE + 2 * RADIUS + 2
_RING = 2 * RADIUS + 2
_X, _Y, _Z, _W = range(0, 4 * _WIDE, _WIDE)  # offsets in a row of raw values
_RAW = 4 * _WIDE
_SUMS = 10 * TILE  # weight, its first moment, weighted position and its first moment; links to the next row
_DOWN, _OVER = 8 * TILE, 9 * TILE
_STEEPEST = 8.0
"""Neighbours on one surface are at most so many times the median distance of neighbours apart."""
_CURVED_SQ = np.float32(0.2**2)
"""Second difference that a curved surface without noise may have, squared, in median distances."""
_NOISE_SQ = np.float32(4.0**2)
_LEAST = np.float32(5.0)
"""Least total weight of a fit, in weights of its own pixel."""
_ZERO, _ONE, _TINY = np.float32(0), np.float32(1), np.float32(1e-12)
_TWO, _THREE, _FOUR = np.float32(2), np.float32(3), np.float32(4)


def normals_of(xyz: F32, sigma_mm: F32, *, stride: int = 1) -> F32:
    """Unit normals towards the camera, (H, W, 3) float32; NaN where there is no point, or too few around it.

    Args:
        xyz: (H, W, 3) mm, on the camera's pixel grid, NaN where invalid, in any rigid frame.
        sigma_mm: (H, W), one standard deviation.
        stride: spacing of the rows and columns that hold points; the others are NaN.
    """
    points, sigma = (np.ascontiguousarray(plane[::stride, ::stride]) for plane in (xyz, sigma_mm))
    # Kernels are compiled for read-only arrays too if they are given any.
    out = np.empty_like(points)
    height, width = sigma.shape
    pitch = np.float32(pitch_mm(points))
    middle = points[::8, ::8, 2]
    reference = np.float32(np.nanmean(middle)) if np.isfinite(middle).any() else _ZERO
    tiles = blocks(width, TILE)
    fit_normals(
        blocks(height, _ROWS) * tiles, _writable(points).reshape(height, -1), _writable(sigma), tiles, reference,
        np.float32((_STEEPEST * pitch) ** 2), _CURVED_SQ * pitch * pitch, out.reshape(height, -1),
    )  # fmt: skip
    if stride == 1:
        return out
    whole = np.full_like(xyz, np.nan)
    whole[::stride, ::stride] = out
    return whole


def pitch_mm(xyz: F32) -> float:
    """Median distance of neighbours in a row, (H, W, 3) -> mm; 0 without neighbours."""
    rows = xyz[:: max(1, len(xyz) // 16)]
    steps = np.diff(rows, axis=1)
    apart = np.sqrt(np.einsum("...k,...k", steps, steps))
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if len(apart) else 0.0


def _writable(array: F32) -> F32:
    """The array, copied if it is read-only: numba would compile the kernel once more for it."""
    return array if array.flags.writeable else array.copy()


@serial
def _load_row(xyz: Any, sigma: Any, first: int, reference: Any, raw: Any) -> None:
    """A row of a tile with its margins; weight and position are 0 where there is no point, and beyond the image.

    Args:
        xyz: (3 W,); sigma: (W,); first: column of the tile's margin.
    """
    begin, end = max(-first, 0), min(sigma.shape[0] - first, _WIDE)
    if end - begin < _WIDE:
        raw[: 4 * _WIDE] = _ZERO
    points, sigmas = xyz[3 * (first + begin) : 3 * (first + end)], sigma[first + begin : first + end]
    inner = raw[begin:]
    for j in range(end - begin):
        s, x, y, z = sigmas[j], points[3 * j], points[3 * j + 1], points[3 * j + 2]
        known = (s == s) & (z == z)
        inner[_X + j], inner[_Y + j] = x if known else _ZERO, y if known else _ZERO
        inner[_Z + j] = z - reference if known else _ZERO
        inner[_W + j] = _ONE / max(s * s, _TINY) if known else _ZERO


@serial
def _link_columns(raw: Any, reach: Any, curved: Any, links: Any) -> None:
    """1 where a pixel and the next one are of one surface, and where those on both sides continue each other."""
    for j in range(_WIDE - 1):
        x, y, z = raw[_X + j + 1] - raw[_X + j], raw[_Y + j + 1] - raw[_Y + j], raw[_Z + j + 1] - raw[_Z + j]
        near = (x * x + y * y + z * z <= reach) & (raw[_W + j] * raw[_W + j + 1] > _ZERO)
        links[j] = _ONE if near else _ZERO
    for j in range(1, _WIDE - 1):
        x = raw[_X + j + 1] - _TWO * raw[_X + j] + raw[_X + j - 1]
        y = raw[_Y + j + 1] - _TWO * raw[_Y + j] + raw[_Y + j - 1]
        z = raw[_Z + j + 1] - _TWO * raw[_Z + j] + raw[_Z + j - 1]
        smooth = _smooth(x, y, z, raw[_W + j - 1], raw[_W + j], raw[_W + j + 1], curved)
        links[_WIDE + j] = links[j - 1] * links[j] * smooth


@serial
def _smooth(x: Any, y: Any, z: Any, before: Any, here: Any, after: Any, curved: Any) -> Any:
    """1 if a second difference is no larger than curvature and noise make it; weights are 1 / sigma^2."""
    variance = _ONE / (before + _TINY) + _FOUR / (here + _TINY) + _ONE / (after + _TINY)
    return _ONE if x * x + y * y + z * z <= curved + _NOISE_SQ * variance else _ZERO


@serial
def _sum_row(raw: Any, links: Any, sums: Any) -> None:
    """Weighted sums along a row over the pixels of each pixel's surface, RADIUS to both sides."""
    for j in range(TILE):
        c = j + RADIUS + 1
        w0 = raw[_W + c]
        ahead1, back1 = links[c], links[c - 1]
        ahead2, back2 = ahead1 * links[_WIDE + c + 1], back1 * links[_WIDE + c - 1]
        ahead3, back3 = ahead2 * links[_WIDE + c + 2], back2 * links[_WIDE + c - 2]
        a1, a2, a3 = ahead1 * raw[_W + c + 1], ahead2 * raw[_W + c + 2], ahead3 * raw[_W + c + 3]
        b1, b2, b3 = back1 * raw[_W + c - 1], back2 * raw[_W + c - 2], back3 * raw[_W + c - 3]
        p2, p3, q1, q2, q3 = _TWO * a2, _THREE * a3, -b1, -_TWO * b2, -_THREE * b3
        sums[j] = w0 + a1 + b1 + a2 + b2 + a3 + b3
        sums[TILE + j] = a1 + q1 + p2 + q2 + p3 + q3
        x1, x2, x3, y1, y2, y3 = (
            raw[_X + c + 1], raw[_X + c + 2], raw[_X + c + 3], raw[_X + c - 1], raw[_X + c - 2], raw[_X + c - 3]
        )  # fmt: skip
        sums[2 * TILE + j] = w0 * raw[_X + c] + a1 * x1 + b1 * y1 + a2 * x2 + b2 * y2 + a3 * x3 + b3 * y3
        sums[5 * TILE + j] = a1 * x1 + q1 * y1 + p2 * x2 + q2 * y2 + p3 * x3 + q3 * y3
        x1, x2, x3, y1, y2, y3 = (
            raw[_Y + c + 1], raw[_Y + c + 2], raw[_Y + c + 3], raw[_Y + c - 1], raw[_Y + c - 2], raw[_Y + c - 3]
        )  # fmt: skip
        sums[3 * TILE + j] = w0 * raw[_Y + c] + a1 * x1 + b1 * y1 + a2 * x2 + b2 * y2 + a3 * x3 + b3 * y3
        sums[6 * TILE + j] = a1 * x1 + q1 * y1 + p2 * x2 + q2 * y2 + p3 * x3 + q3 * y3
        x1, x2, x3, y1, y2, y3 = (
            raw[_Z + c + 1], raw[_Z + c + 2], raw[_Z + c + 3], raw[_Z + c - 1], raw[_Z + c - 2], raw[_Z + c - 3]
        )  # fmt: skip
        sums[4 * TILE + j] = w0 * raw[_Z + c] + a1 * x1 + b1 * y1 + a2 * x2 + b2 * y2 + a3 * x3 + b3 * y3
        sums[7 * TILE + j] = a1 * x1 + q1 * y1 + p2 * x2 + q2 * y2 + p3 * x3 + q3 * y3


@serial
def _link_rows(above: Any, here: Any, below: Any, reach: Any, curved: Any, before: Any, sums: Any) -> None:
    """Links of a row to the next one, and whether it continues from the row before to the next one.

    Args:
        above, here, below: raw rows; before: sums of the row above, with its links; sums: of this row, changed.
    """
    for j in range(TILE):
        c = j + RADIUS + 1
        x, y, z = below[_X + c] - here[_X + c], below[_Y + c] - here[_Y + c], below[_Z + c] - here[_Z + c]
        near = (x * x + y * y + z * z <= reach) & (here[_W + c] * below[_W + c] > _ZERO)
        link = _ONE if near else _ZERO
        x, y, z = x - here[_X + c] + above[_X + c], y - here[_Y + c] + above[_Y + c], z - here[_Z + c] + above[_Z + c]
        smooth = _smooth(x, y, z, above[_W + c], here[_W + c], below[_W + c], curved)
        sums[_DOWN + j] = link
        sums[_OVER + j] = link * smooth * before[_DOWN + j]


@serial
def _fit_row(up3: Any, up2: Any, up1: Any, here: Any, down1: Any, down2: Any, down3: Any, raw: Any, out: Any) -> None:
    """Normals (3 TILE,) of a row from the sums of seven."""
    for j in range(TILE):
        a1, b1 = here[_DOWN + j], up1[_DOWN + j]
        a2, b2 = a1 * down1[_OVER + j], b1 * up1[_OVER + j]
        a3, b3 = a2 * down2[_OVER + j], b2 * up2[_OVER + j]
        p2, p3, q1, q2, q3 = _TWO * a2, _THREE * a3, -b1, -_TWO * b2, -_THREE * b3
        k = j
        x1, x2, x3, y1, y2, y3 = down1[k], down2[k], down3[k], up1[k], up2[k], up3[k]
        n = here[k] + a1 * x1 + b1 * y1 + a2 * x2 + b2 * y2 + a3 * x3 + b3 * y3
        v = a1 * x1 + q1 * y1 + p2 * x2 + q2 * y2 + p3 * x3 + q3 * y3
        k += TILE
        u = here[k] + a1 * down1[k] + b1 * up1[k] + a2 * down2[k] + b2 * up2[k] + a3 * down3[k] + b3 * up3[k]
        inverse = _ONE / max(n, _TINY)
        # Moments about the mean, relative to the total weight: products stay in the range of single precision.
        u, v = u * inverse, v * inverse
        k += TILE
        x1, x2, x3, y1, y2, y3 = down1[k], down2[k], down3[k], up1[k], up2[k], up3[k]
        x0 = here[k] + a1 * x1 + b1 * y1 + a2 * x2 + b2 * y2 + a3 * x3 + b3 * y3
        xv = (a1 * x1 + q1 * y1 + p2 * x2 + q2 * y2 + p3 * x3 + q3 * y3 - v * x0) * inverse
        k += TILE
        x1, x2, x3, y1, y2, y3 = down1[k], down2[k], down3[k], up1[k], up2[k], up3[k]
        y0 = here[k] + a1 * x1 + b1 * y1 + a2 * x2 + b2 * y2 + a3 * x3 + b3 * y3
        yv = (a1 * x1 + q1 * y1 + p2 * x2 + q2 * y2 + p3 * x3 + q3 * y3 - v * y0) * inverse
        k += TILE
        x1, x2, x3, y1, y2, y3 = down1[k], down2[k], down3[k], up1[k], up2[k], up3[k]
        z0 = here[k] + a1 * x1 + b1 * y1 + a2 * x2 + b2 * y2 + a3 * x3 + b3 * y3
        zv = (a1 * x1 + q1 * y1 + p2 * x2 + q2 * y2 + p3 * x3 + q3 * y3 - v * z0) * inverse
        k += TILE
        xu = here[k] + a1 * down1[k] + b1 * up1[k] + a2 * down2[k] + b2 * up2[k] + a3 * down3[k] + b3 * up3[k]
        k += TILE
        yu = here[k] + a1 * down1[k] + b1 * up1[k] + a2 * down2[k] + b2 * up2[k] + a3 * down3[k] + b3 * up3[k]
        k += TILE
        zu = here[k] + a1 * down1[k] + b1 * up1[k] + a2 * down2[k] + b2 * up2[k] + a3 * down3[k] + b3 * up3[k]
        xu, yu, zu = (xu - u * x0) * inverse, (yu - u * y0) * inverse, (zu - u * z0) * inverse
        nx, ny, nz = yv * zu - zv * yu, zv * xu - xv * zu, xv * yu - yv * xu
        square = nx * nx + ny * ny + nz * nz
        w = raw[_W + RADIUS + 1 + j]
        known = (w > _ZERO) & (n >= _LEAST * w) & (square > _TINY)
        scale = _ONE / root(max(square, _TINY)) if known else np.float32(np.nan)
        out[j], out[TILE + j], out[2 * TILE + j] = nx * scale, ny * scale, nz * scale


@parallel
def fit_normals(
    tile: int, xyz: Any, sigma: Any, tiles: int, reference: Any, reach: Any, curved: Any, out: Any
) -> None:  # fmt: skip
    """Normals of one tile of TILE columns and _ROWS rows.

    Args:
        xyz: (H, 3 W) float32; sigma: (H, W) float32; tiles: number of tiles in a row of them.
        reference: depth that is subtracted, against rounding; reach: largest squared distance of neighbours, mm^2.
        curved: largest squared second difference without noise, mm^2; out: (H, 3 W) float32, result.
    """
    height, width = sigma.shape
    low, left = tile // tiles * _ROWS, tile % tiles * TILE
    high, count = min(low + _ROWS, height), min(TILE, width - left)
    raw, sums = np.zeros((_RING, _RAW), np.float32), np.zeros((_RING, _SUMS), np.float32)
    links, row = np.zeros(2 * _WIDE, np.float32), np.zeros(3 * TILE, np.float32)
    for y in range(low - RADIUS - 1, high + RADIUS):
        new, old, older = (y + _RING) % _RING, (y - 1 + _RING) % _RING, (y - 2 + _RING) % _RING
        if 0 <= y < height:
            _load_row(xyz[y], sigma[y], left - RADIUS - 1, reference, raw[new])
            _link_columns(raw[new], reach, curved, links)
            _sum_row(raw[new], links, sums[new])
        else:
            raw[new], sums[new] = _ZERO, _ZERO
        _link_rows(raw[older], raw[old], raw[new], reach, curved, sums[older], sums[old])
        i = y - RADIUS
        if i < low:
            continue
        k = i + _RING
        _fit_row(
            sums[(k - 3) % _RING], sums[(k - 2) % _RING], sums[(k - 1) % _RING], sums[k % _RING],
            sums[(k + 1) % _RING], sums[(k + 2) % _RING], sums[(k + 3) % _RING], raw[k % _RING], row,
        )  # fmt: skip
        written = out[i, 3 * left :]
        for j in range(count):
            written[3 * j], written[3 * j + 1], written[3 * j + 2] = row[j], row[TILE + j], row[2 * TILE + j]
