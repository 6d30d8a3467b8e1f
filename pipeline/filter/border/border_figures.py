"""Fifteen figures that compare a pixel at a border with the pixels of its own surface around it.

Neighbours, texture, phase against the projector, modulation, brightness, and the distance from their plane. Depths are
counted in fringe orders, so that neither the size of the rig nor its units matter.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import allocating, inline, linked, serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.filter.border.border_model import FIGURES
from pipeline.filter.border.border_pixels import REACH, ROWS, distance_right, pixels_of_band
from pipeline.filter.texture_agreement import DEVIATION_STEPS, MISFIT_STEPS
from pipeline.match.match_result import RESIDUAL_STEP

# Slots of a tile: one neighbour of every pixel, sums over the neighbours of its surface, and the plane through them.
SAME, LOSS_OF, MODULATION, MEAN, FIRST, SECOND, DEPTH = range(7)
OWN_DEPTH, N, BESIDE, SUMS = 7, 8, 9, 10
SX, SY, SXX, SXY, SYY, SZ, SXZ, SYZ, SZZ = range(15, 24)
OFF, SLOPE, RMS = range(24, 27)
BESIDE_RIGHT = 27
OUT = 28
"""The figures."""
SLOTS = OUT + FIGURES


class Planes(NamedTuple):
    """What the figures are computed from; (H, W) unless stated.

    Args:
        label: uint16, one more than the surface, 0 = none; deviation, misfit: of
            :class:`pipeline.filter.texture_agreement.Agreement`.
        right_u: uint16; residual_normalised, residual: int16, of :class:`pipeline.match.match_result.MatchResult`.
        modulation, mean: uint8; xyz, sigma: (stride H, stride W, 3) and (stride H, stride W), mm.
    """

    label: Any
    deviation: Any
    misfit: Any
    right_u: Any
    residual_normalised: Any
    residual: Any
    modulation: Any
    mean: Any
    xyz: Any
    sigma: Any


@linked
def _gather(p: Any, losses: Any, at: Any, depth_at: Any, own: Any, ahead: int, depth_ahead: int, t: Any) -> None:
    """Values of one neighbour of every pixel into the slots up to DEPTH.

    Args:
        p: :class:`Planes`, flat; at, depth_at: (n,) the pixels' places in the planes and in ``xyz``; own: their labels.
        ahead, depth_ahead: from there to the neighbour's.
    """
    for m in range(at.shape[0]):
        # Unsigned, or numba tests every index for being negative.
        k, d = np.uint32(at[m] + ahead), np.uint32(depth_at[m] + depth_ahead)
        t[SAME * TILE + m] = np.float32(p.label[k] == own[m])
        t[LOSS_OF * TILE + m] = losses[p.deviation[k]]
        t[MODULATION * TILE + m], t[MEAN * TILE + m] = np.float32(p.modulation[k]), np.float32(p.mean[k])
        t[FIRST * TILE + m], t[SECOND * TILE + m] = np.float32(p.residual_normalised[k]), np.float32(p.residual[k])
        t[DEPTH * TILE + m] = p.xyz[d]


@inline
def _add(t: Any, x: Any, y: Any, beside: Any) -> None:
    """Add the gathered neighbour at (x, y) to the sums, where it belongs to the pixel's surface."""
    for m in range(TILE):
        own = t[SAME * TILE + m]
        z = t[DEPTH * TILE + m] - t[OWN_DEPTH * TILE + m]
        z = z if own > np.float32(0.0) else np.float32(0.0)
        t[N * TILE + m] += own
        t[BESIDE * TILE + m] += own * beside
        t[(SUMS + 0) * TILE + m] += own * t[LOSS_OF * TILE + m]
        t[(SUMS + 1) * TILE + m] += own * t[MODULATION * TILE + m]
        t[(SUMS + 2) * TILE + m] += own * t[MEAN * TILE + m]
        t[(SUMS + 3) * TILE + m] += own * t[FIRST * TILE + m]
        t[(SUMS + 4) * TILE + m] += own * t[SECOND * TILE + m]
        t[SX * TILE + m] += own * x
        t[SY * TILE + m] += own * y
        t[SXX * TILE + m] += own * (x * x)
        t[SXY * TILE + m] += own * (x * y)
        t[SYY * TILE + m] += own * (y * y)
        t[SZ * TILE + m] += z
        t[SXZ * TILE + m] += x * z
        t[SYZ * TILE + m] += y * z
        t[SZZ * TILE + m] += z * z


@inline
def _plane(t: Any) -> None:
    """Distance from the plane of the neighbours' depths (OFF), its slope (SLOPE) and rms residual (RMS), mm.

    The ridge keeps the slopes of few neighbours near 0.
    """
    one, two, zero = np.float32(1.0), np.float32(2.0), np.float32(0.0)
    for m in range(TILE):
        n, sx, sy = t[N * TILE + m], t[SX * TILE + m], t[SY * TILE + m]
        sxx, sxy, syy = t[SXX * TILE + m], t[SXY * TILE + m], t[SYY * TILE + m]
        sz, sxz, syz = t[SZ * TILE + m], t[SXZ * TILE + m], t[SYZ * TILE + m]
        some = n > zero
        axx, ayy = sxx + one, syy + one
        c00, c01, c02 = axx * ayy - sxy * sxy, sy * sxy - sx * ayy, sx * sxy - axx * sy
        c11, c12, c22 = n * ayy - sy * sy, sx * sy - n * sxy, n * axx - sx * sx
        inverse = one / (n * c00 + sx * c01 + sy * c02 if some else one)
        d = (c00 * sz + c01 * sxz + c02 * syz) * inverse
        u, v = (c01 * sz + c11 * sxz + c12 * syz) * inverse, (c02 * sz + c12 * sxz + c22 * syz) * inverse
        squares = t[SZZ * TILE + m] - two * (d * sz + u * sxz + v * syz) + d * d * n + u * u * sxx + v * v * syy
        squares += two * (d * u * sx + d * v * sy + u * v * sxy)
        t[OFF * TILE + m] = abs(d)
        t[SLOPE * TILE + m] = np.float32(sqrt(u * u + v * v))
        t[RMS * TILE + m] = np.float32(sqrt(max(squares, zero) / max(n, one)))


@allocating
def figures(p: Any, losses: Any, stride: int, per_order: Any, at: Any, t: Any) -> None:
    """The figures of up to TILE pixels, into the slots from OUT on.

    Args:
        p: :class:`Planes`; losses: (256,) float32, by deviation; per_order: change of 1 / z from order to order.
        at: (n, 2) int32, rows and columns; t: (SLOTS TILE,) float32, scratch.
    """
    f, one = np.float32, np.float32(1.0)
    n = at.shape[0]
    width, wide = p.label.shape[1], 3 * stride * p.xyz.shape[1]
    flat = Planes(
        p.label.reshape(-1), p.deviation.reshape(-1), p.misfit.reshape(-1), p.right_u.reshape(-1),
        p.residual_normalised.reshape(-1), p.residual.reshape(-1), p.modulation.reshape(-1), p.mean.reshape(-1),
        p.xyz.reshape(-1), p.sigma.reshape(-1),
    )  # fmt: skip
    own, place, depth_place = np.empty(TILE, np.uint16), np.empty(n, np.int32), np.empty(n, np.int32)
    t[: OUT * TILE] = f(0.0)
    for m in range(n):
        i, j = at[m, 0], at[m, 1]
        place[m], depth_place[m] = i * width + j, i * wide + 3 * stride * j + 2
        own[m], t[OWN_DEPTH * TILE + m] = p.label[i, j], p.xyz[stride * i, stride * j, 2]
    # Every second pixel of 5 x 5, as the colours of a chessboard: nearly as good as all, at half of the time.
    for dy in range(-REACH, REACH + 1):
        for dx in range(-REACH, REACH + 1):
            if (dy + dx) % 2 != 0 or (dy == 0 and dx == 0):
                continue
            _gather(flat, losses, place, depth_place, own, dy * width + dx, dy * wide + 3 * stride * dx, t)
            _add(t, f(dx), f(dy), one if abs(dy) == 1 else f(0.0))
    _plane(t)
    for m in range(n):
        i, j, k = at[m, 0], at[m, 1], np.uint32(place[m])
        t[SAME * TILE + m], t[DEPTH * TILE + m] = f(flat.misfit[k]), p.sigma[stride * i, stride * j]
        t[LOSS_OF * TILE + m], t[MODULATION * TILE + m] = f(flat.deviation[k]), f(flat.modulation[k])
        t[MEAN * TILE + m], t[FIRST * TILE + m] = f(flat.mean[k]), f(flat.residual_normalised[k])
        t[SECOND * TILE + m], t[BESIDE_RIGHT * TILE + m] = (
            f(flat.residual[k]),
            distance_right(p.label[i], p.right_u[i], j),
        )
    _compare(t, per_order, one / f(stride))


@serial
def _compare(t: Any, per_order: Any, per_stride: Any) -> None:
    """The figures from the sums and the pixels' own values; each between 0 and about 2.

    In the same array: the compiler then sees that they do not overlap with what they are computed from.
    """
    f, one = np.float32, np.float32(1.0)
    for m in range(TILE):
        n, z = t[N * TILE + m], max(t[OWN_DEPTH * TILE + m], f(1e-3))
        per, orders = one / max(n, one), one / (z * z * per_order)
        off, sigma = t[OFF * TILE + m] * orders, t[DEPTH * TILE + m] * orders
        rms, slope = t[RMS * TILE + m] * orders, t[SLOPE * TILE + m] * orders * per_stride
        residual, normalised = t[(SUMS + 4) * TILE + m] * per, t[(SUMS + 3) * TILE + m] * per
        t[(OUT + 0) * TILE + m], t[(OUT + 1) * TILE + m] = t[BESIDE * TILE + m] * f(0.25), n * f(1 / 12)
        t[(OUT + 2) * TILE + m] = min(t[LOSS_OF * TILE + m] * f(1 / DEVIATION_STEPS), f(6.0)) * f(1 / 3)
        t[(OUT + 3) * TILE + m] = min(t[SUMS * TILE + m] * per, f(3.0))
        t[(OUT + 4) * TILE + m] = min(abs(t[SECOND * TILE + m] - residual) * f(RESIDUAL_STEP), one)
        t[(OUT + 5) * TILE + m] = min(abs(t[FIRST * TILE + m] - normalised) * f(4 * RESIDUAL_STEP), f(2.0))
        t[(OUT + 6) * TILE + m] = min(t[MODULATION * TILE + m] * n / max(t[(SUMS + 1) * TILE + m], one), f(1.2))
        t[(OUT + 7) * TILE + m] = min(abs(t[MEAN * TILE + m] * n / max(t[(SUMS + 2) * TILE + m], one) - one), one)
        t[(OUT + 8) * TILE + m], t[(OUT + 9) * TILE + m] = off / (off + f(0.03)), sigma / (sigma + f(0.003))
        t[(OUT + 10) * TILE + m], t[(OUT + 11) * TILE + m] = rms / (rms + f(0.01)), slope / (slope + f(0.02))
        t[(OUT + 12) * TILE + m] = t[SAME * TILE + m] * f(1 / MISFIT_STEPS)
        t[(OUT + 13) * TILE + m] = off / (off + f(3.0) * sigma + f(1e-9))
        t[(OUT + 14) * TILE + m] = t[BESIDE_RIGHT * TILE + m]


@allocating
def figures_of(t: Any) -> Any:
    """The figures of :func:`figures` as (FIGURES, TILE), a view."""
    return t[OUT * TILE :].reshape(FIGURES, TILE)


@parallel_allocating
def border_figures(band: int, planes: Any, losses: Any, stride: int, per_order: Any, out: Any) -> None:
    """The figures of every border pixel of a band, (H, W, FIGURES) float32, NaN elsewhere, to fit the model to."""
    at = np.empty((ROWS * planes.label.shape[1] + 1, 2), np.int32)
    t = np.empty(SLOTS * TILE, np.float32)
    x = figures_of(t)
    out[band * ROWS : (band + 1) * ROWS] = np.nan
    n = pixels_of_band(planes.label, planes.right_u, band, at)
    for start in range(0, n, TILE):
        some = at[start : min(start + TILE, n)]
        figures(planes, losses, stride, per_order, some, t)
        for m in range(some.shape[0]):
            out[some[m, 0], some[m, 1]] = x[:, m]
