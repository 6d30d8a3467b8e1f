"""Sub-pixel match along the epipolar curve, and the point.

For a left pixel with a known order the right camera must see the same pointwise phase at the image of the point. The
unknown is one number, the inverse depth w = 1/z on the pixel's viewing ray; some Newton steps on the phases, from where
the projector's column lies, find it. Because the match is sought along the ray's own epipolar curve, by both full
camera models, the four linear equations of the two views (see :mod:`pipeline.triangulate`) agree there: the point on
the ray is their solution.

Everything is done for tiles of one picture row (see :mod:`pipeline.tiles`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.kernels import inline, parallel, prange
from pipeline.located import LARGEST_RESIDUAL, OUTSIDE, PIXEL_STEPS, RESIDUAL_STEP, TURN_STEPS
from pipeline.packed import imaginary, real
from pipeline.tiles import TILE, angle, clamped, root, turned

_COHERENCE_SQ = np.float32(0.16)
_STEPS, _CONVERGED = 2, np.float32(0.1)
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_TURN, _TINY = np.float32(2 * np.pi), np.float32(1e-20)
_PER_PIXEL, _FARTHEST = np.float32(PIXEL_STEPS), np.float32(OUTSIDE)
_PER_RADIAN, _LARGEST = np.float32(1 / RESIDUAL_STEP), np.float32(LARGEST_RESIDUAL)
_PER_TURN = np.float32(TURN_STEPS / (2 * np.pi))

# Slots of the scratch array of floats, and of the one of integers.
_RE, _IM, _PHI, _BIAS, _RX, _RY = (k * TILE for k in range(6))
_W, _X, _Y, _EX, _EY = (k * TILE for k in range(6, 11))
_FRACTION, _ACROSS = (k * TILE for k in range(11, 13))
_AR, _AI, _BR, _BI, _SQ, _VAR = (k * TILE for k in range(13, 19))
_OK, _SLOPE, _T0, _T1, _U, _V = (k * TILE for k in range(19, 25))
_SLOTS = 25
_CELL, _P00, _P10, _P01, _P11 = (k * TILE for k in range(5))
_INTEGER_SLOTS = 5


@inline
def _ray(t: Any, d: Any, j: int) -> tuple[Any, Any, Any]:
    """Direction of the pixel's ray in a device's frame."""
    rx, ry = t[_RX + j], t[_RY + j]
    return d[0] * rx + d[1] * ry + d[2], d[4] * rx + d[5] * ry + d[6], d[8] * rx + d[9] * ry + d[10]


@inline
def _pixel(d: Any, ax: Any, ay: Any, az: Any, w: Any) -> tuple[Any, Any]:
    """Pixel of the point at inverse depth w of a ray; ``d`` as :func:`pipeline.tables.packed`, float32."""
    inv = _ONE / (az + d[11] * w)
    a, b = (ax + d[3] * w) * inv, (ay + d[7] * w) * inv
    aa, bb, ab = a * a, b * b, a * b
    r2 = aa + bb
    radial = _ONE + r2 * (d[17] + r2 * (d[18] + r2 * d[21]))
    xd = a * radial + _TWO * d[19] * ab + d[20] * (r2 + _TWO * aa)
    yd = b * radial + d[19] * (r2 + _TWO * bb) + _TWO * d[20] * ab
    return d[12] * xd + d[13] * yd + d[14], d[15] * yd + d[16]


@inline
def _columns(t: Any, k: Any, columns: Any, linear: bool) -> None:
    """Projector coordinate (slot _U) of the absolute phase in slot _T0; ``columns`` is an even grid."""
    start, per, last = columns[0], _ONE / columns[1], np.float32(columns.shape[0] - 3)
    if linear:
        rate = (columns[columns.shape[0] - 1] - columns[2]) / (columns[1] * last)
        for j in range(TILE):
            t[_U + j] = columns[2] + (t[_T0 + j] - start) * rate
        return
    for j in range(TILE):
        where = clamped((t[_T0 + j] - start) * per, _ZERO, last - np.float32(1e-3))
        k[_CELL + j] = np.int32(where)
        t[_FRACTION + j] = where - np.float32(k[_CELL + j])
    for j in range(TILE):
        i = np.uint32(k[_CELL + j] + 2)
        t[_T1 + j] = columns[i]
        t[_U + j] = columns[i + np.uint32(1)]
    for j in range(TILE):
        t[_U + j] = t[_T1 + j] + t[_FRACTION + j] * (t[_U + j] - t[_T1 + j])


@inline
def _projected_phase(t: Any, k: Any, axis: int, phases: Any, linear: bool, correction: Any) -> None:
    """The projector's absolute phase (slot _T0) at its pixels in slots _U, _V."""
    last = phases.shape[0] - 1
    for j in range(TILE):
        u, v = (t[_U + j], t[_V + j]) if axis == 0 else (t[_V + j], t[_U + j])
        t[_T1 + j] = u + correction[0] + correction[1] * u + correction[2] * v
    if linear:
        rate = (phases[last] - phases[0]) / np.float32(last)
        for j in range(TILE):
            t[_T0 + j] = phases[0] + t[_T1 + j] * rate
        return
    for j in range(TILE):
        k[_CELL + j] = np.int32(clamped(t[_T1 + j], _ZERO, np.float32(last) - np.float32(1e-3)))
        t[_FRACTION + j] = t[_T1 + j] - np.float32(k[_CELL + j])
    for j in range(TILE):
        m = np.uint32(k[_CELL + j])
        t[_T0 + j], t[_T1 + j] = phases[m], phases[m + np.uint32(1)]
    for j in range(TILE):
        t[_T0 + j] += t[_FRACTION + j] * (t[_T1 + j] - t[_T0 + j])


@inline
def _meet(t: Any, d: Any, axis: int, correction: Any) -> None:
    """Inverse depth (slot _W) at which the ray meets the projector coordinate of slot _U.

    The pinhole solution, then one step that takes the lens in.
    """
    o = 4 * axis
    f, skew, c = (d[12], d[13], d[14]) if axis == 0 else (d[15], _ZERO, d[16])
    c1, c2 = correction[1], correction[2]
    for j in range(TILE):
        ax, ay, az = _ray(t, d, j)
        along, across = (ax, ay) if axis == 0 else (ay, ax)
        u = t[_U + j] - (correction[0] + c1 * t[_U + j])
        top = f * along + skew * across + c * az
        move = f * d[3 + o] + skew * d[7] + c * d[11]
        w = (top - u * az) / (u * d[11] - move)
        pu, pv = _pixel(d, ax, ay, az, w)
        inv = _ONE / (az + d[11] * w)
        pinhole = (top + move * w) * inv
        seen, other = (pu, pv) if axis == 0 else (pv, pu)
        u = u - c2 * other + pinhole - seen
        t[_W + j] = (top - u * az) / (u * d[11] - move)


@inline
def _cells(t: Any, k: Any, along: int, width: int, height: int) -> None:
    """Cell of the other picture (flat index) and the place in it of the pixels in slots _X, _Y."""
    right, bottom = np.float32(width) - np.float32(2.01), np.float32(height) - np.float32(2.01)
    for j in range(TILE):
        x, y = clamped(t[_X + j], _ONE, right), clamped(t[_Y + j], _ONE, bottom)
        i, m = np.int32(y), np.int32(x)
        k[j] = i * np.int32(width) + m
        fx, fy = x - np.float32(m), y - np.float32(i)
        t[_FRACTION + j] = fx if along == 1 else fy
        t[_ACROSS + j] = fy if along == 1 else fx


@inline
def _fetch(t: Any, k: Any, other: Any, along: int, across: int) -> None:
    """Phasors at both ends of the cells along the growth of the phase, linear across; ``other`` flat, packed."""
    step, beside = np.uint32(along), np.uint32(across)
    for j in range(TILE):
        i = np.uint32(k[_CELL + j])
        k[_P00 + j], k[_P10 + j] = other[i], other[i + step]
        i += beside
        k[_P01 + j], k[_P11 + j] = other[i], other[i + step]
    for j in range(TILE):
        f = t[_ACROSS + j]
        a, b, c, d = real(k[_P00 + j]), imaginary(k[_P00 + j]), real(k[_P10 + j]), imaginary(k[_P10 + j])
        e, g, h, q = real(k[_P01 + j]), imaginary(k[_P01 + j]), real(k[_P11 + j]), imaginary(k[_P11 + j])
        t[_AR + j], t[_AI + j] = a + f * (e - a), b + f * (g - b)
        t[_BR + j], t[_BI + j] = c + f * (h - c), d + f * (q - d)


@inline
def _error(t: Any, j: int) -> tuple[Any, Any, Any, Any]:
    """Phase of the other picture minus this one's; the interpolated phasor; the phase's step across the cell."""
    ar, ai, br, bi = t[_AR + j], t[_AI + j], t[_BR + j], t[_BI + j]
    f = t[_FRACTION + j]
    re, im = ar + f * (br - ar), ai + f * (bi - ai)
    hr, hi = t[_RE + j], t[_IM + j]
    return angle(re * hr + im * hi, im * hr - re * hi), re, im, angle(ar * br + ai * bi, ar * bi - ai * br)


@parallel
def refine(
    order: Any, rays_x: Any, rays_y: Any, phase: Any, equalized: Any, phasor: Any, variance: Any,
    other: Any, other_variance: Any, device: Any, projector: Any, axis: int, base: float, span: float,
    columns: Any, phases: Any, linear: bool, correction: Any, floor_sq: float, correlation: float,
    known: Any, depth_mm: Any, sigma_mm: Any, match_u: Any, match_v: Any, source_u: Any, source_v: Any, absolute: Any,
    residual_eq: Any, residual: Any,
) -> None:  # fmt: skip
    """Match and locate every pixel that has an order; all arrays float32 unless said.

    Args:
        order: (H, W) int16; rays_x, rays_y: (H, W) ideal normalised points of the pixels.
        phasor, equalized, other: (H, W) int32, packed; floor_sq: least squared size of a packed phasor.
        device, projector: packed models of the other camera and the projector; axis: 0 = phase grows along u.
        base, span: 1/z = base + span s, s = 0 .. 1 in the measuring volume.
        columns: even-grid table phase -> projector coordinate; phases: phase at each projector coordinate;
            linear: both are straight lines.
        correlation: of neighbouring phases' noise in the other picture (0 pointwise, more after a window fit).
        known ... residual: the planes of :class:`pipeline.located.Located`, written. (One by one: what a parallel
            kernel writes to the members of a tuple can get lost.)
    """
    height, width = order.shape
    other_height, other_width = other_variance.shape
    flat, flat_variance = other.reshape(-1), other_variance.reshape(-1)
    along, across = (1, other_width) if axis == 0 else (other_width, 1)
    tiles = (width + TILE - 1) // TILE
    delta = np.float32(0.01 * span)
    loss = _TWO * (_ONE - correlation)
    for i in prange(height):
        t, k = np.zeros(_SLOTS * TILE, np.float32), np.zeros(_INTEGER_SLOTS * TILE, np.int32)
        for tile in range(tiles):
            j0 = tile * TILE
            n = min(TILE, width - j0)
            found = 0
            row = order[i, j0 : j0 + n]
            for j in range(n):
                active = row[j] != -32768
                found += active
                t[_OK + j] = _ONE if active else _ZERO
            if found == 0:
                for j in range(n):
                    known[i, np.uint32(j0 + j)] = 0
                continue
            _load(t, n, row, phase[i, j0 : j0 + n], equalized[i, j0 : j0 + n], phasor[i, j0 : j0 + n],
                  rays_x[i, j0 : j0 + n], rays_y[i, j0 : j0 + n])  # fmt: skip
            _columns(t, k, columns, linear)
            _meet(t, projector, axis, correction)
            for j in range(TILE):
                ax, ay, az = _ray(t, device, j)
                w = t[_W + j]
                x, y = _pixel(device, ax, ay, az, w)
                x1, y1 = _pixel(device, ax, ay, az, w + delta)
                t[_X + j], t[_Y + j] = x, y
                t[_EX + j], t[_EY + j] = (x1 - x) / delta, (y1 - y) / delta
                t[_T0 + j] = w
            for _ in range(_STEPS):
                _cells(t, k, along, other_width, other_height)
                _fetch(t, k, flat, along, across)
                for j in range(TILE):
                    f, re, im, step = _error(t, j)
                    ex, ey = t[_EX + j], t[_EY + j]
                    slope = step * (ex if axis == 0 else ey)
                    move = -f / (slope if slope != _ZERO else _TINY)
                    t[_W + j] += move
                    t[_X + j] += ex * move
                    t[_Y + j] += ey * move
            _cells(t, k, along, other_width, other_height)
            _fetch(t, k, flat, along, across)
            _evidence(t, k, flat_variance, along, across)
            for j in range(TILE):
                f, re, im, step = _error(t, j)
                ex, ey = t[_EX + j], t[_EY + j]
                slope = step * (ex if axis == 0 else ey)
                slope = slope if slope != _ZERO else _TINY
                x, y = t[_X + j], t[_Y + j]
                size = re * re + im * im
                good = (abs(f) < _CONVERGED) & (size >= floor_sq) & (size > _COHERENCE_SQ * t[_SQ + j])
                good &= abs(t[_W + j] - t[_T0 + j]) * abs(slope) < np.float32(3.0)
                good &= (x >= _ONE) & (y >= _ONE)
                good &= (x < np.float32(other_width - 2)) & (y < np.float32(other_height - 2))
                w = t[_W + j] - f / slope
                s = (w - base) / span
                good &= (s > np.float32(-0.02)) & (s < np.float32(1.02))
                a, b = t[_FRACTION + j], t[_ACROSS + j]
                v = t[_VAR + j] * (_ONE - loss * a * (_ONE - a)) * (_ONE - loss * b * (_ONE - b))
                good &= v < _ONE
                t[_OK + j] = t[_OK + j] if good else _ZERO
                t[_W + j] = w
                t[_X + j], t[_Y + j] = x - ex * f / slope, y - ey * f / slope
                t[_VAR + j] = v
                t[_SLOPE + j] = abs(slope)
            for j in range(TILE):
                ax, ay, az = _ray(t, projector, j)
                t[_U + j], t[_V + j] = _pixel(projector, ax, ay, az, t[_W + j])
            _projected_phase(t, k, axis, phases, linear, correction)
            for j in range(TILE):
                t[_T1 + j] = t[_PHI + j] - t[_T0 + j]
                t[_T0 + j] = t[_T1 + j] + t[_BIAS + j]
            end = j0 + n
            _store_points(t, n, variance[i, j0:end], known[i, j0:end], depth_mm[i, j0:end], sigma_mm[i, j0:end])
            _store_places(t, n, match_u[i, j0:end], match_v[i, j0:end], source_u[i, j0:end], source_v[i, j0:end])
            _store_phases(t, n, absolute[i, j0:end], residual_eq[i, j0:end], residual[i, j0:end])


@inline
def _load(t: Any, n: int, order: Any, phase: Any, equalized: Any, phasor: Any, rays_x: Any, rays_y: Any) -> None:
    """The left picture's side of a tile; slots _PHI, _BIAS and _T0 get the absolute phase, bias, equalised phase."""
    for j in range(n):
        t[_PHI + j] = phase[j] + _TURN * np.float32(order[j])
    for j in range(n):
        t[_RX + j], t[_RY + j] = rays_x[j], rays_y[j]
    for j in range(n):
        t[_RE + j], t[_IM + j] = real(phasor[j]), imaginary(phasor[j])
    for j in range(n):
        t[_BIAS + j] = turned(real(equalized[j]), imaginary(equalized[j]), t[_RE + j], t[_IM + j])
    for j in range(TILE):
        t[_T0 + j] = t[_PHI + j] + t[_BIAS + j]


@inline
def _evidence(t: Any, k: Any, variance: Any, along: int, across: int) -> None:
    """The phasors' mean square (slot _SQ) in each cell, and the variance (slot _VAR) of the pixel nearest to it.

    After :func:`_fetch`.
    """
    step, beside = np.int32(along), np.int32(across)
    for j in range(TILE):
        f, g = t[_FRACTION + j], t[_ACROSS + j]
        a, b, c, d = real(k[_P00 + j]), imaginary(k[_P00 + j]), real(k[_P10 + j]), imaginary(k[_P10 + j])
        e, o, h, q = real(k[_P01 + j]), imaginary(k[_P01 + j]), real(k[_P11 + j]), imaginary(k[_P11 + j])
        near, far = a * a + b * b, c * c + d * d
        near += g * (e * e + o * o - near)
        far += g * (h * h + q * q - far)
        t[_SQ + j] = near + f * (far - near)
        k[_CELL + j] += (step if f > _HALF else np.int32(0)) + (beside if g > _HALF else np.int32(0))
    for j in range(TILE):
        t[_VAR + j] = variance[np.uint32(k[_CELL + j])]


@inline
def _store_points(t: Any, n: int, variance: Any, known: Any, depth: Any, sigma: Any) -> None:
    for j in range(n):
        z = _ONE / t[_W + j]
        rx, ry = t[_RX + j], t[_RY + j]
        depth[j] = z
        sigma[j] = root((variance[j] + t[_VAR + j]) * (rx * rx + ry * ry + _ONE)) / t[_SLOPE + j] * z * z
    for j in range(n):
        known[j] = np.uint8(t[_OK + j] > _ZERO)


@inline
def _store_places(t: Any, n: int, match_u: Any, match_v: Any, source_u: Any, source_v: Any) -> None:
    for j in range(n):
        match_u[j], match_v[j] = _steps_of_pixel(t[_X + j]), _steps_of_pixel(t[_Y + j])
    for j in range(n):
        source_u[j], source_v[j] = _steps_of_pixel(t[_U + j]), _steps_of_pixel(t[_V + j])


@inline
def _store_phases(t: Any, n: int, absolute: Any, residual_eq: Any, residual: Any) -> None:
    for j in range(n):
        residual_eq[j], residual[j] = _steps_of_residual(t[_T0 + j]), _steps_of_residual(t[_T1 + j])
    for j in range(n):
        absolute[j] = np.int16(np.int32(np.rint(t[_PHI + j] * _PER_TURN)))


@inline
def _steps_of_pixel(x: Any) -> Any:
    """A coordinate in steps from the picture's edge, see :mod:`pipeline.located`."""
    x = (x + _HALF) * _PER_PIXEL
    return np.uint16(np.int32(x if (x >= _ZERO) & (x < _FARTHEST) else _FARTHEST))


@inline
def _steps_of_residual(x: Any) -> Any:
    return np.int16(np.int32(np.rint(clamped(x * _PER_RADIAN, -_LARGEST, _LARGEST))))
