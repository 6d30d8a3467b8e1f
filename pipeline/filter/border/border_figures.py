"""Eighteen figures that compare a pixel at a border with the pixels around it, of its own surface and of others.

Neighbours, texture, phase against the projector, brightness, and depth: the distance from the plane of its own surface,
and the step to the other one. Depths are counted in fringe orders, so that neither the size of the rig nor its units
matter.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import allocating, inline, linked, serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.filter.border.border_model import FIGURES
from pipeline.filter.border.border_pixels import REACH, ROWS, pixels_of_band
from pipeline.filter.texture_agreement import DEVIATION_STEPS, MISFIT_STEPS
from pipeline.match.match_result import RESIDUAL_STEP

# Slots of a tile: one neighbour of every pixel, sums over those of its surface, sums over the others, and the plane
# through those of its surface.
SAME, OTHER, LOSS_OF, MEAN, FIRST, SECOND, DEPTH = range(7)
OWN_DEPTH, N, LOSSES, MEANS, FIRSTS, SECONDS = range(7, 13)
SX, SY, SXX, SXY, SYY, SZ, SXZ, SYZ, SZZ = range(13, 22)
OTHERS, OTHER_LOSSES, OTHER_DEPTHS, OUTSIDE_MEANS = range(22, 26)
OFF, SLOPE, RMS, GRADIENT = range(26, 30)
OUT = 30
"""The figures."""
SLOTS = OUT + FIGURES
_NEIGHBOURS = 12
"""Pixels around that are compared: every second one of 5 x 5."""


class Planes(NamedTuple):
    """What the figures are computed from; (H, W) unless stated.

    Args:
        label: uint16, one more than the surface, 0 = none; deviation, misfit: of
            :class:`pipeline.filter.texture_agreement.Agreement`.
        right_u: uint16; residual_normalised, residual: int16, of :class:`pipeline.match.match_result.MatchResult`.
        mean: uint8; xyz, sigma: (stride H, stride W, 3) and (stride H, stride W), mm.
    """

    label: Any
    deviation: Any
    misfit: Any
    right_u: Any
    residual_normalised: Any
    residual: Any
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
        label = p.label[k]
        t[SAME * TILE + m] = np.float32(label == own[m])
        t[OTHER * TILE + m] = np.float32((label != own[m]) & (label != 0))
        t[LOSS_OF * TILE + m], t[MEAN * TILE + m] = losses[p.deviation[k]], np.float32(p.mean[k])
        t[FIRST * TILE + m], t[SECOND * TILE + m] = np.float32(p.residual_normalised[k]), np.float32(p.residual[k])
        t[DEPTH * TILE + m] = p.xyz[d]


@inline
def _add(t: Any, x: Any, y: Any) -> None:
    """Add the gathered neighbour at (x, y) to the sums over the pixel's surface, or to those over the rest."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for m in range(TILE):
        own, other = t[SAME * TILE + m], t[OTHER * TILE + m]
        loss, mean = t[LOSS_OF * TILE + m], t[MEAN * TILE + m]
        step = t[DEPTH * TILE + m] - t[OWN_DEPTH * TILE + m]
        z = step if own > zero else zero
        t[N * TILE + m] += own
        t[LOSSES * TILE + m] += own * loss
        t[MEANS * TILE + m] += own * mean
        t[FIRSTS * TILE + m] += own * t[FIRST * TILE + m]
        t[SECONDS * TILE + m] += own * t[SECOND * TILE + m]
        t[OTHERS * TILE + m] += other
        t[OTHER_LOSSES * TILE + m] += other * loss
        t[OTHER_DEPTHS * TILE + m] += step if other > zero else zero
        t[OUTSIDE_MEANS * TILE + m] += (one - own) * mean
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
        p.residual_normalised.reshape(-1), p.residual.reshape(-1), p.mean.reshape(-1), p.xyz.reshape(-1),
        p.sigma.reshape(-1),
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
            _add(t, f(dx), f(dy))
    _plane(t)
    for m in range(n):
        i, j, k = at[m, 0], at[m, 1], np.uint32(place[m])
        t[SAME * TILE + m], t[DEPTH * TILE + m] = f(flat.misfit[k]), p.sigma[stride * i, stride * j]
        t[LOSS_OF * TILE + m], t[MEAN * TILE + m] = f(flat.deviation[k]), f(flat.mean[k])
        t[SECOND * TILE + m] = f(flat.residual[k])
        across = f(p.mean[i, j + 1]) - f(p.mean[i, j - 1])
        t[GRADIENT * TILE + m] = abs(across) + abs(f(p.mean[i + 1, j]) - f(p.mean[i - 1, j]))
    _compare(t, per_order, one / f(stride))


@serial
def _compare(t: Any, per_order: Any, per_stride: Any) -> None:
    """The figures from the sums and the pixels' own values; each between -1 and 3.

    In the same array: the compiler then sees that they do not overlap with what they are computed from.
    """
    f, one, two = np.float32, np.float32(1.0), np.float32(2.0)
    for m in range(TILE):
        n, others, z = t[N * TILE + m], t[OTHERS * TILE + m], max(t[OWN_DEPTH * TILE + m], f(1e-3))
        per, per_other, orders = one / max(n, one), one / max(others, one), one / (z * z * per_order)
        off, sigma = t[OFF * TILE + m] * orders, t[DEPTH * TILE + m] * orders
        rms, slope = t[RMS * TILE + m] * orders, t[SLOPE * TILE + m] * orders * per_stride
        normalised, residual = t[FIRSTS * TILE + m] * per, t[SECONDS * TILE + m] * per
        step = t[OTHER_DEPTHS * TILE + m] * per_other * orders
        here, own = t[MEAN * TILE + m], t[MEANS * TILE + m] * per
        outside = t[OUTSIDE_MEANS * TILE + m] / max(f(_NEIGHBOURS) - n, one)
        # Less contrast than a tenth of the brightness and two counts shows no place between both.
        contrast, least = outside - own, f(0.1) * own + two
        share = (here - own) * contrast / (contrast * contrast + least * least)
        t[(OUT + 0) * TILE + m], t[(OUT + 1) * TILE + m] = n * f(1 / _NEIGHBOURS), others * f(1 / _NEIGHBOURS)
        t[(OUT + 2) * TILE + m] = min(t[LOSS_OF * TILE + m] * f(1 / DEVIATION_STEPS), f(6.0)) * f(1 / 3)
        t[(OUT + 3) * TILE + m] = min(t[LOSSES * TILE + m] * per, f(3.0))
        t[(OUT + 4) * TILE + m] = min(t[OTHER_LOSSES * TILE + m] * per_other, f(3.0))
        t[(OUT + 5) * TILE + m] = min(abs(t[SECOND * TILE + m] - residual) * f(RESIDUAL_STEP), one)
        t[(OUT + 6) * TILE + m] = min(abs(residual) * f(4 * RESIDUAL_STEP), two)
        t[(OUT + 7) * TILE + m] = min(abs(normalised) * f(4 * RESIDUAL_STEP), two)
        t[(OUT + 8) * TILE + m] = min(abs(here / max(own, one) - one), one)
        t[(OUT + 9) * TILE + m], t[(OUT + 10) * TILE + m] = off / (off + f(0.03)), sigma / (sigma + f(0.003))
        t[(OUT + 11) * TILE + m], t[(OUT + 12) * TILE + m] = rms / (rms + f(0.01)), slope / (slope + f(0.02))
        t[(OUT + 13) * TILE + m] = t[SAME * TILE + m] * f(1 / MISFIT_STEPS)
        t[(OUT + 14) * TILE + m] = step / (abs(step) + f(0.3))
        t[(OUT + 15) * TILE + m] = contrast / (outside + own + f(4.0))
        t[(OUT + 16) * TILE + m] = min(max(share, -one), two)
        t[(OUT + 17) * TILE + m] = min(t[GRADIENT * TILE + m] / (here + two), two)


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
