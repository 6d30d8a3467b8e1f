"""Steps of the sub-pixel match, each for a tile of pixels of the left image (see :mod:`pipeline.common.tile_math`).

A pixel's viewing ray is met with the projector's column, and the other camera's image is read where it sees that
point: phasors, interpolated, never wrapped phases.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline
from pipeline.common.tile_math import TILE, angle, clamped
from pipeline.decode.packed_phasor import imaginary, real

FEW = 8
"""Pixels that are matched together where a whole tile is not worth it; a divisor of TILE."""

_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_TINY = np.float32(1e-20)
_MOST_SHORTENED = np.float32(0.2)

# Slots of the scratch array of floats, and of the one of integers.
RE, IM, PHI, BIAS, RX, RY = (k * TILE for k in range(6))
W, X, Y, EX, EY = (k * TILE for k in range(6, 11))
FRACTION, ACROSS = (k * TILE for k in range(11, 13))
_AR, _AI, _BR, _BI = (k * TILE for k in range(13, 17))
ERROR, SLOPE, SIZE, SQUARE, VARIANCE = (k * TILE for k in range(17, 22))
OK, T0, T1, U, V = (k * TILE for k in range(22, 27))
SLOTS = 27
_CELL, _P00, _P10, _P01, _P11 = (k * TILE for k in range(5))
INTEGER_SLOTS = 5


@inline
def ray(t: Any, d: Any, j: int) -> tuple[Any, Any, Any]:
    """Direction of the pixel's ray in a device's frame."""
    rx, ry = t[RX + j], t[RY + j]
    return d[0] * rx + d[1] * ry + d[2], d[4] * rx + d[5] * ry + d[6], d[8] * rx + d[9] * ry + d[10]


@inline
def pixel(d: Any, ax: Any, ay: Any, az: Any, w: Any) -> tuple[Any, Any]:
    """Pixel of the point at inverse depth w of a ray; ``d`` as :func:`pipeline.geometry.ray_tables.packed`, float32."""
    inv = _ONE / (az + d[11] * w)
    a, b = (ax + d[3] * w) * inv, (ay + d[7] * w) * inv
    aa, bb, ab = a * a, b * b, a * b
    r2 = aa + bb
    radial = _ONE + r2 * (d[17] + r2 * (d[18] + r2 * d[21]))
    xd = a * radial + _TWO * d[19] * ab + d[20] * (r2 + _TWO * aa)
    yd = b * radial + d[19] * (r2 + _TWO * bb) + _TWO * d[20] * ab
    return d[12] * xd + d[13] * yd + d[14], d[15] * yd + d[16]


@inline
def columns_of(t: Any, k: Any, columns: Any, linear: bool) -> None:
    """Projector coordinate (slot U) of the absolute phase in slot T0; ``columns`` is an even grid."""
    start, per, last = columns[0], _ONE / columns[1], np.float32(columns.shape[0] - 3)
    if linear:
        rate = (columns[columns.shape[0] - 1] - columns[2]) / (columns[1] * last)
        for j in range(TILE):
            t[U + j] = columns[2] + (t[T0 + j] - start) * rate
        return
    for j in range(TILE):
        where = clamped((t[T0 + j] - start) * per, _ZERO, last - np.float32(1e-3))
        k[_CELL + j] = np.int32(where)
        t[FRACTION + j] = where - np.float32(k[_CELL + j])
    for j in range(TILE):
        i = np.uint32(k[_CELL + j] + 2)
        t[T1 + j] = columns[i]
        t[U + j] = columns[i + np.uint32(1)]
    for j in range(TILE):
        t[U + j] = t[T1 + j] + t[FRACTION + j] * (t[U + j] - t[T1 + j])


@inline
def projected_phase(t: Any, k: Any, axis: int, phases: Any, linear: bool, correction: Any) -> None:
    """The projector's absolute phase (slot T0) at its pixels in slots U, V."""
    last = phases.shape[0] - 1
    for j in range(TILE):
        u, v = (t[U + j], t[V + j]) if axis == 0 else (t[V + j], t[U + j])
        t[T1 + j] = u + correction[0] + correction[1] * u + correction[2] * v
    if linear:
        rate = (phases[last] - phases[0]) / np.float32(last)
        for j in range(TILE):
            t[T0 + j] = phases[0] + t[T1 + j] * rate
        return
    for j in range(TILE):
        k[_CELL + j] = np.int32(clamped(t[T1 + j], _ZERO, np.float32(last) - np.float32(1e-3)))
        t[FRACTION + j] = t[T1 + j] - np.float32(k[_CELL + j])
    for j in range(TILE):
        m = np.uint32(k[_CELL + j])
        t[T0 + j], t[T1 + j] = phases[m], phases[m + np.uint32(1)]
    for j in range(TILE):
        t[T0 + j] += t[FRACTION + j] * (t[T1 + j] - t[T0 + j])


@inline
def meet(t: Any, d: Any, axis: int, correction: Any) -> None:
    """Inverse depth (slot W) at which the ray meets the projector coordinate of slot U.

    The pinhole solution, then one step that takes the lens in.
    """
    o = 4 * axis
    f, skew, c = (d[12], d[13], d[14]) if axis == 0 else (d[15], _ZERO, d[16])
    c1, c2 = correction[1], correction[2]
    for j in range(TILE):
        ax, ay, az = ray(t, d, j)
        along, across = (ax, ay) if axis == 0 else (ay, ax)
        u = t[U + j] - (correction[0] + c1 * t[U + j])
        top = f * along + skew * across + c * az
        move = f * d[3 + o] + skew * d[7] + c * d[11]
        w = (top - u * az) / (u * d[11] - move)
        pu, pv = pixel(d, ax, ay, az, w)
        inv = _ONE / (az + d[11] * w)
        pinhole = (top + move * w) * inv
        seen, other = (pu, pv) if axis == 0 else (pv, pu)
        u = u - c2 * other + pinhole - seen
        t[W + j] = (top - u * az) / (u * d[11] - move)


@inline
def look_up(t: Any, k: Any, other: Any, along: int, across: int, width: int, height: int, lanes: int) -> None:
    """Phasors of the other image about the pixels in slots X, Y of the first ``lanes`` of a tile.

    At both ends of the cells along the growth of the phase, linear across it; ``other`` flat, packed. ``lanes`` is a
    constant: TILE or FEW.
    """
    right, bottom = np.float32(width) - np.float32(2.01), np.float32(height) - np.float32(2.01)
    for j in range(lanes):
        x, y = clamped(t[X + j], _ONE, right), clamped(t[Y + j], _ONE, bottom)
        i, m = np.int32(y), np.int32(x)
        k[j] = i * np.int32(width) + m
        fx, fy = x - np.float32(m), y - np.float32(i)
        t[FRACTION + j] = fx if along == 1 else fy
        t[ACROSS + j] = fy if along == 1 else fx
    step, beside = np.uint32(along), np.uint32(across)
    for j in range(lanes):
        here = np.uint32(k[_CELL + j])
        k[_P00 + j], k[_P10 + j] = other[here], other[here + step]
        here += beside
        k[_P01 + j], k[_P11 + j] = other[here], other[here + step]
    for j in range(lanes):
        f = t[ACROSS + j]
        a, b, c, d = real(k[_P00 + j]), imaginary(k[_P00 + j]), real(k[_P10 + j]), imaginary(k[_P10 + j])
        e, g, h, q = real(k[_P01 + j]), imaginary(k[_P01 + j]), real(k[_P11 + j]), imaginary(k[_P11 + j])
        t[_AR + j], t[_AI + j] = a + f * (e - a), b + f * (g - b)
        t[_BR + j], t[_BI + j] = c + f * (h - c), d + f * (q - d)


@inline
def errors(t: Any, axis: int, blur: Any, lanes: int) -> None:
    """Phase of the other image minus this one's (slot ERROR), its change with W (SLOPE), the size squared (SIZE).

    Channels of unequal reflectance add a phasor that does not rotate with the phase; slot BIAS holds the negative of
    the phase error that follows. The linear interpolation of a phasor that rotates by ``step`` between two pixels
    shortens it by 1 - f (1 - f) step^2 / 2, which enlarges that error in the other image, as does the other camera's
    blur, by the share ``blur``; the difference is taken out.
    """
    for j in range(lanes):
        ar, ai, br, bi = t[_AR + j], t[_AI + j], t[_BR + j], t[_BI + j]
        f = t[FRACTION + j]
        re, im = ar + f * (br - ar), ai + f * (bi - ai)
        hr, hi = t[RE + j], t[IM + j]
        step = angle(ar * br + ai * bi, ar * bi - ai * br)
        slope = step * (t[EX + j] if axis == 0 else t[EY + j])
        shortened = min(_HALF * f * (_ONE - f) * step * step, _MOST_SHORTENED)
        t[ERROR + j] = angle(re * hr + im * hi, im * hr - re * hi) + (shortened + blur) * t[BIAS + j]
        t[SLOPE + j] = slope if slope != _ZERO else _TINY
        t[SIZE + j] = re * re + im * im


@inline
def move(t: Any, lanes: int) -> None:
    """One Newton step along the epipolar curve."""
    for j in range(lanes):
        by = -t[ERROR + j] / t[SLOPE + j]
        t[W + j] += by
        t[X + j] += t[EX + j] * by
        t[Y + j] += t[EY + j] * by


@inline
def evidence(t: Any, k: Any, variance: Any, along: int, across: int, lanes: int) -> None:
    """Mean square of the phasors in each cell (slot SQUARE), variance of the pixel nearest to it (slot VARIANCE).

    After :func:`look_up`.
    """
    step, beside = np.int32(along), np.int32(across)
    for j in range(lanes):
        f, g = t[FRACTION + j], t[ACROSS + j]
        a, b, c, d = real(k[_P00 + j]), imaginary(k[_P00 + j]), real(k[_P10 + j]), imaginary(k[_P10 + j])
        e, o, h, q = real(k[_P01 + j]), imaginary(k[_P01 + j]), real(k[_P11 + j]), imaginary(k[_P11 + j])
        near, far = a * a + b * b, c * c + d * d
        near += g * (e * e + o * o - near)
        far += g * (h * h + q * q - far)
        t[SQUARE + j] = near + f * (far - near)
        k[_CELL + j] += (step if f > _HALF else np.int32(0)) + (beside if g > _HALF else np.int32(0))
    for j in range(lanes):
        t[VARIANCE + j] = variance[np.uint32(k[_CELL + j])]
