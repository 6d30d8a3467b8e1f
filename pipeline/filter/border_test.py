"""Points at the border of a surface: rejected where they are probably wrong, and given the sigma that they have.

A pixel at a border sees two surfaces, or is fitted from a window that straddles them. Fifteen figures compare it with
the pixels of its own surface around it: neighbours, texture, phase against the projector, modulation, brightness, and
its distance from their plane. A quadratic logistic regression of these gives the probability that the point is wrong,
a linear one of the logarithm the variance of its error. Depths are counted in fringe orders, so that neither the size
of the rig nor its units matter. ``python -m benchmarks.border_model`` fits the coefficients in
:mod:`pipeline.filter.border_model` to simulated images.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import inline, serial
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import TILE
from pipeline.filter.border_model import FIGURES
from pipeline.filter.texture_agreement import DEVIATION_STEPS, MISFIT_STEPS
from pipeline.match.match_result import PIXEL_STEPS, RESIDUAL_STEP

REACH = 2
"""Half width of the neighbourhood that is compared, pixels."""
RIGHT_STEPS = 3 * PIXEL_STEPS // 2
"""Distance in the right image up to which a pixel counts as near the border, whose window may straddle it there."""
FARTHEST = 6
"""Farthest such pixel in the left image, pixels."""
ROWS = 8
"""Rows that share their scratch arrays."""
_NO = np.uint8(0)
# Slots of a tile: one neighbour of every pixel, sums over the neighbours of its surface, and the plane through them.
SAME, LOSS_OF, MODULATION, MEAN, FIRST, SECOND, DEPTH = range(7)
OWN_DEPTH, N, BESIDE, SUMS = 7, 8, 9, 10
SX, SY, SXX, SXY, SYY, SZ, SXZ, SYZ, SZZ = range(15, 24)
OFF, SLOPE, RMS = range(24, 27)
BESIDE_RIGHT = 27
SLOTS = 28
_LARGEST_LOG = np.float32(9.0)


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


def largest_odds(probability: float) -> np.float32:
    """The logarithm of the odds of a probability 0..1; infinite at 1, where nothing is rejected."""
    return np.float32(log(probability / (1 - probability)) if probability < 1 else np.inf)


@serial
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


@serial
def figures(p: Any, losses: Any, stride: int, per_order: Any, at: Any, t: Any, out: Any) -> None:
    """The figures of up to TILE pixels.

    Args:
        p: :class:`Planes`; losses: (256,) float32, by deviation; per_order: change of 1 / z from order to order.
        at: (n, 2) int32, rows and columns; t: (SLOTS TILE,) float32, scratch; out: (FIGURES, TILE) float32.
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
    t[:] = f(0.0)
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
        t[SECOND * TILE + m], t[BESIDE_RIGHT * TILE + m] = f(flat.residual[k]), _distance(p.label[i], p.right_u[i], j)
    _compare(t, per_order, one / f(stride), out)


@serial
def _compare(t: Any, per_order: Any, per_stride: Any, out: Any) -> None:
    """The figures (FIGURES, TILE) from the sums and the pixels' own values; each between 0 and about 2."""
    f, one = np.float32, np.float32(1.0)
    for m in range(TILE):
        n, z = t[N * TILE + m], max(t[OWN_DEPTH * TILE + m], f(1e-3))
        per, orders = one / max(n, one), one / (z * z * per_order)
        off, sigma = t[OFF * TILE + m] * orders, t[DEPTH * TILE + m] * orders
        rms, slope = t[RMS * TILE + m] * orders, t[SLOPE * TILE + m] * orders * per_stride
        residual, normalised = t[(SUMS + 4) * TILE + m] * per, t[(SUMS + 3) * TILE + m] * per
        out[0, m], out[1, m] = t[BESIDE * TILE + m] * f(0.25), n * f(1 / 12)
        out[2, m] = min(t[LOSS_OF * TILE + m] * f(1 / DEVIATION_STEPS), f(6.0)) * f(1 / 3)
        out[3, m] = min(t[SUMS * TILE + m] * per, f(3.0))
        out[4, m] = min(abs(t[SECOND * TILE + m] - residual) * f(RESIDUAL_STEP), one)
        out[5, m] = min(abs(t[FIRST * TILE + m] - normalised) * f(4 * RESIDUAL_STEP), f(2.0))
        out[6, m] = min(t[MODULATION * TILE + m] * n / max(t[(SUMS + 1) * TILE + m], one), f(1.2))
        out[7, m] = min(abs(t[MEAN * TILE + m] * n / max(t[(SUMS + 2) * TILE + m], one) - one), one)
        out[8, m], out[9, m] = off / (off + f(0.03)), sigma / (sigma + f(0.003))
        out[10, m], out[11, m] = rms / (rms + f(0.01)), slope / (slope + f(0.02))
        out[12, m], out[13, m] = t[SAME * TILE + m] * f(1 / MISFIT_STEPS), off / (off + f(3.0) * sigma + f(1e-9))
        out[14, m] = t[BESIDE_RIGHT * TILE + m]


@serial
def _distance(label: Any, right_u: Any, j: int) -> Any:
    """Distance to the border along the row in the right image, in :data:`RIGHT_STEPS`, at most 2."""
    k, width, least = label[j], label.shape[0], 2 * RIGHT_STEPS
    for step in (-1, 1):
        at = j
        for _ in range(FARTHEST):
            if at + step < 0 or at + step >= width or label[at + step] != k:
                least = min(least, int(abs(np.int32(right_u[at]) - np.int32(right_u[j]))))
                break
            at += step
    return np.float32(least) * np.float32(1 / RIGHT_STEPS)


@serial
def border_of_row(label: Any, right_u: Any, i: int, out: Any) -> None:
    """1 where the border of the pixel's surface lies within its reach, or near along the row in the right image.

    Args:
        label: (H, W) uint16; right_u: (H, W) uint16, steps; out: (W,) uint8.
    """
    height, width = label.shape
    out[:] = _NO
    if i < REACH or i >= height - REACH:
        return
    here, inner = label[i], out[REACH : width - REACH]
    for a in range(-REACH, REACH + 1):
        for b in range(5):
            other = label[i + a, b : b + width - 2 * REACH]
            k = here[REACH : width - REACH]
            for j in range(inner.shape[0]):
                inner[j] |= np.uint8(other[j] != k[j])
    u = right_u[i]
    for d in range(REACH + 1, FARTHEST + 1):
        near, far, edge = here[: width - d], here[d:], here[d - 1 : width - 1]
        first, last = u[: width - d], u[d - 1 : width - 1]
        ahead = out[: width - d]
        for j in range(width - d):
            close = np.uint16(last[j] - first[j] + RIGHT_STEPS) <= np.uint16(2 * RIGHT_STEPS)
            ahead[j] |= np.uint8((far[j] != near[j]) & (edge[j] == near[j]) & close)
        near, far, edge = here[d:], here[: width - d], here[1 : width - d + 1]
        first, last = u[d:], u[1 : width - d + 1]
        behind = out[d:]
        for j in range(width - d):
            close = np.uint16(last[j] - first[j] + RIGHT_STEPS) <= np.uint16(2 * RIGHT_STEPS)
            behind[j] |= np.uint8((far[j] != near[j]) & (edge[j] == near[j]) & close)
    for j in range(width):
        out[j] = out[j] if here[j] != 0 else _NO
    out[:REACH], out[width - REACH :] = _NO, _NO


@serial
def log_odds(x: Any, wrong: Any, out: Any) -> None:
    """Logarithms of the odds that points are wrong, (TILE,).

    Args:
        x: (n, TILE) standardised figures; wrong: (1 + n + n (n + 1) / 2,) coefficients.
    """
    inner = np.empty(TILE, np.float32)
    out[:] = wrong[0]
    at = 1 + FIGURES
    for k in range(FIGURES):
        inner[:] = wrong[1 + k]
        for other in range(k + 1):
            w = wrong[at]
            at += 1
            for m in range(TILE):
                inner[m] += w * x[other, m]
        for m in range(TILE):
            out[m] += x[k, m] * inner[m]


@serial
def log_variance(x: Any, spread: Any, out: Any) -> None:
    """Logarithms of the variance in units of that of the noise, (TILE,); ``spread``: (1 + 2 n,) coefficients."""
    out[:] = spread[0]
    for k in range(FIGURES):
        linear, square = spread[1 + k], spread[1 + FIGURES + k]
        for m in range(TILE):
            out[m] += x[k, m] * (linear + square * x[k, m])


@serial
def _pixels_of_band(label: Any, right_u: Any, band: int, at: Any) -> int:
    """Border pixels of a band into ``at`` (ROWS W + 1, 2) int32, rows and columns; their number."""
    height, width = label.shape
    border = np.empty(width, np.uint8)
    n = 0
    for i in range(band * ROWS, min((band + 1) * ROWS, height)):
        border_of_row(label, right_u, i, border)
        for j in range(width):
            at[n, 0], at[n, 1] = i, j
            n += border[j]
    return n


@parallel
def border_test(
    band: int, planes: Any, losses: Any, stride: int, per_order: Any, model: Any, limit: Any, valid: Any, misfit: Any,
    sigma: Any,
) -> None:  # fmt: skip
    """Reject border points that are probably wrong, and give the others the standard deviation of their error.

    Args:
        band: number of :data:`ROWS` rows; planes: :class:`Planes`; losses: by deviation.
        per_order: change of 1 / z from one order to the next, 1 / mm.
        model: :class:`pipeline.filter.border_model.BorderModel`; limit: log odds above which a point is rejected.
        valid: (H, W) uint8, changed; misfit: (H, W) uint8, set to 0 where ``sigma`` (stride H, stride W) is widened.
    """
    at = np.empty((ROWS * planes.label.shape[1] + 1, 2), np.int32)
    t, x = np.empty(SLOTS * TILE, np.float32), np.empty((FIGURES, TILE), np.float32)
    odds, more = np.empty(TILE, np.float32), np.empty(TILE, np.float32)
    n = _pixels_of_band(planes.label, planes.right_u, band, at)
    for start in range(0, n, TILE):
        some = at[start : min(start + TILE, n)]
        figures(planes, losses, stride, per_order, some, t, x)
        for k in range(FIGURES):
            mean, scale = model.mean[k], model.scale[k]
            for m in range(TILE):
                x[k, m] = (x[k, m] - mean) * scale
        log_odds(x, model.wrong, odds)
        log_variance(x, model.spread, more)
        for m in range(some.shape[0]):
            i, j = some[m, 0], some[m, 1]
            if valid[i, j] == 0:
                continue
            if odds[m] > limit:
                valid[i, j] = _NO
                continue
            misfit[i, j] = _NO
            factor = exp(np.float32(0.5) * min(max(more[m], np.float32(0.0)), _LARGEST_LOG))
            sigma[stride * i, stride * j] *= np.float32(factor)


@parallel
def border_figures(band: int, planes: Any, losses: Any, stride: int, per_order: Any, out: Any) -> None:
    """The figures of every border pixel of a band, (H, W, FIGURES) float32, NaN elsewhere, to fit the model to."""
    at = np.empty((ROWS * planes.label.shape[1] + 1, 2), np.int32)
    t, x = np.empty(SLOTS * TILE, np.float32), np.empty((FIGURES, TILE), np.float32)
    out[band * ROWS : (band + 1) * ROWS] = np.nan
    n = _pixels_of_band(planes.label, planes.right_u, band, at)
    for start in range(0, n, TILE):
        some = at[start : min(start + TILE, n)]
        figures(planes, losses, stride, per_order, some, t, x)
        for m in range(some.shape[0]):
            out[some[m, 0], some[m, 1]] = x[:, m]
