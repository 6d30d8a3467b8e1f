"""Sub-pixel match along the epipolar curve, and the point.

For a left pixel with a known order the right camera must see the same pointwise phase at the image of the point. The
unknown is one number, the inverse depth w = 1/z on the pixel's viewing ray; some Newton steps on the phases, from where
the projector's column lies, find it. Because the match is sought along the ray's own epipolar curve, by both full
camera models, the four linear equations of the two views (see :mod:`pipeline.geometry.triangulate`) agree there: the
point on the ray is their solution.

Everything is done for tiles of one image row (see :mod:`pipeline.common.tile_math`). Two samples of the other image
suffice for nine pixels in ten; the others are gathered for a third one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.match.epipolar_search import (  # isort: skip
    ACROSS, BIAS, ERROR, EX, EY, FEW, FRACTION, IM, INTEGER_SLOTS, OK, PHI, RE, RX, RY, SIZE, SLOPE, SLOTS, SQUARE, T0,
    T1, U, V, VARIANCE, W, X, Y, columns_of, errors, evidence, look_up, meet, move, pixel, projected_phase, ray,
)  # fmt: skip
from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import TILE, clamped, root
from pipeline.decode.packed_phasor import imaginary, real
from pipeline.decode.pixel_descriptor import bias_of
from pipeline.match.match_result import LARGEST_RESIDUAL, OUTSIDE, PIXEL_STEPS, RESIDUAL_STEP, TURN_STEPS

_COHERENCE_SQ = np.float32(0.16)
_CONVERGED = np.float32(0.1)
ROWS = 8
"""Rows that share their scratch arrays."""
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_TURN = np.float32(2 * np.pi)
_PER_PIXEL, _FARTHEST = np.float32(PIXEL_STEPS), np.float32(OUTSIDE)
_PER_RADIAN, _LARGEST = np.float32(1 / RESIDUAL_STEP), np.float32(LARGEST_RESIDUAL)
_PER_TURN = np.float32(TURN_STEPS / (2 * np.pi))


@parallel
def refine(
    block: int, order: Any, rays_x: Any, rays_y: Any, phase: Any, descriptors: Any, phasor: Any, variance: Any,
    other: Any, other_variance: Any, device: Any, projector: Any, axis: int, base: float, span: float,
    columns: Any, phases: Any, linear: bool, correction: Any, floor_sq: float, correlation: float, stride: int,
    xyz: Any, sigma: Any, valid: Any, right_u: Any, right_v: Any, projector_u: Any, projector_v: Any,
    absolute_phase: Any, residual_normalised: Any, residual: Any,
) -> None:  # fmt: skip
    """Match and locate every pixel that has an order; all arrays float32 unless stated.

    Args:
        order: (H, W) int16; rays_x, rays_y: (H, W) ideal normalised points of the pixels.
        descriptors: (H, W) int32, see :mod:`pipeline.decode.pixel_descriptor`; phasor, other: (H, W) int32, packed.
        floor_sq: least squared size of a packed phasor.
        device, projector: packed models of the other camera and the projector; axis: 0 = phase grows along u.
        base, span: 1/z = base + span s, s = 0 .. 1 in the measuring volume.
        columns: even-grid table phase -> projector coordinate; phases: phase at each projector coordinate;
            linear: both are straight lines.
        correlation: of neighbouring phases' noise in the other image (0 pointwise, more after a window fit).
        xyz, sigma: (every H, every W, 3) and (every H, every W) or a little less, mm; pixel (i, j) is theirs at (every
            i, every j). Written where valid; elsewhere perhaps.
        valid ... residual: the planes of :class:`pipeline.match.match_result.MatchResult`, written. (One by one: what a
            parallel kernel writes to the members of a tuple can get lost.)
    """
    height, width = order.shape
    other_height, other_width = other_variance.shape
    flat, flat_variance = other.reshape(-1), other_variance.reshape(-1)
    along, across = (1, other_width) if axis == 0 else (other_width, 1)
    tiles = (width + TILE - 1) // TILE
    delta = np.float32(0.01 * span)
    loss = _TWO * (_ONE - correlation)
    t, k = np.zeros(SLOTS * TILE, np.float32), np.zeros(INTEGER_SLOTS * TILE, np.int32)
    few, few_k = np.zeros(SLOTS * TILE, np.float32), np.zeros(INTEGER_SLOTS * TILE, np.int32)
    again = np.empty(TILE, np.int32)
    for number in range(ROWS * tiles):
        i, tile = block * ROWS + number // tiles, number % tiles
        if i >= height:
            break
        j0 = tile * TILE
        n = min(TILE, width - j0)
        found = 0
        row = order[i, j0 : j0 + n]
        for j in range(n):
            active = row[j] != -32768
            found += active
            t[OK + j] = _ONE if active else _ZERO
        if found == 0:
            for j in range(n):
                valid[i, np.uint32(j0 + j)] = 0
            continue
        _load(t, n, row, phase[i, j0 : j0 + n], descriptors[i, j0 : j0 + n], phasor[i, j0 : j0 + n],
              rays_x[i, j0 : j0 + n], rays_y[i, j0 : j0 + n])  # fmt: skip
        columns_of(t, k, columns, linear)
        meet(t, projector, axis, correction)
        for j in range(TILE):
            ax, ay, az = ray(t, device, j)
            w = t[W + j]
            x, y = pixel(device, ax, ay, az, w)
            x1, y1 = pixel(device, ax, ay, az, w + delta)
            t[X + j], t[Y + j] = x, y
            t[EX + j], t[EY + j] = (x1 - x) / delta, (y1 - y) / delta
            t[T0 + j] = w
        look_up(t, k, flat, along, across, other_width, other_height, TILE)
        errors(t, axis, TILE)
        move(t, TILE)
        look_up(t, k, flat, along, across, other_width, other_height, TILE)
        errors(t, axis, TILE)
        evidence(t, k, flat_variance, along, across, TILE)
        left = 0
        for j in range(n):
            again[left] = j
            left += (t[OK + j] > _ZERO) & (abs(t[ERROR + j]) >= _CONVERGED)
        # Most of these are at the border of something, and few: often one sample for all of them.
        for o in range(0, left, FEW):
            some = again[o : min(o + FEW, left)]
            _gather(t, some, few)
            move(few, FEW)
            look_up(few, few_k, flat, along, across, other_width, other_height, FEW)
            errors(few, axis, FEW)
            evidence(few, few_k, flat_variance, along, across, FEW)
            _put_back(few, some, t)
        for j in range(TILE):
            f, slope, ex, ey = t[ERROR + j], t[SLOPE + j], t[EX + j], t[EY + j]
            x, y, size = t[X + j], t[Y + j], t[SIZE + j]
            good = (abs(f) < _CONVERGED) & (size >= floor_sq) & (size > _COHERENCE_SQ * t[SQUARE + j])
            good &= abs(t[W + j] - t[T0 + j]) * abs(slope) < np.float32(3.0)
            good &= (x >= _ONE) & (y >= _ONE)
            good &= (x < np.float32(other_width - 2)) & (y < np.float32(other_height - 2))
            by = -f / slope
            w = t[W + j] + by
            s = (w - base) / span
            good &= (s > np.float32(-0.02)) & (s < np.float32(1.02))
            a, b = t[FRACTION + j], t[ACROSS + j]
            v = t[VARIANCE + j] * (_ONE - loss * a * (_ONE - a)) * (_ONE - loss * b * (_ONE - b))
            good &= v < _ONE
            active = t[OK + j]
            t[OK + j] = active if good else _ZERO
            t[W + j] = w
            t[X + j], t[Y + j] = x + ex * by, y + ey * by
            t[VARIANCE + j] = v
            t[SLOPE + j] = abs(slope)
        for j in range(TILE):
            ax, ay, az = ray(t, projector, j)
            t[U + j], t[V + j] = pixel(projector, ax, ay, az, t[W + j])
        projected_phase(t, k, axis, phases, linear, correction)
        for j in range(TILE):
            t[T1 + j] = t[PHI + j] - t[T0 + j]
            t[T0 + j] = t[T1 + j] + t[BIAS + j]
        end = j0 + n
        _store_phases(t, n, absolute_phase[i, j0:end], residual_normalised[i, j0:end], residual[i, j0:end])
        _store_places(t, n, right_u[i, j0:end], right_v[i, j0:end], projector_u[i, j0:end], projector_v[i, j0:end])
        _store_points(t, n, variance[i, j0:end], j0, stride, xyz[stride * i], sigma[stride * i], valid[i, j0:end])


@inline
def _load(t: Any, n: int, order: Any, phase: Any, descriptors: Any, phasor: Any, rays_x: Any, rays_y: Any) -> None:
    """The left image's side of a tile; slots PHI, BIAS and T0 get the absolute phase, bias, normalised phase."""
    for j in range(n):
        t[PHI + j] = phase[j] + _TURN * np.float32(order[j])
    for j in range(n):
        t[RX + j], t[RY + j] = rays_x[j], rays_y[j]
    for j in range(n):
        t[RE + j], t[IM + j] = real(phasor[j]), imaginary(phasor[j])
    for j in range(n):
        t[BIAS + j] = bias_of(descriptors[j], phase[j])
    for j in range(TILE):
        t[T0 + j] = t[PHI + j] + t[BIAS + j]


@inline
def _gather(t: Any, pixels: Any, few: Any) -> None:
    """What another Newton step needs of some pixels, to the front of another tile."""
    for m in range(pixels.shape[0]):
        j = np.uint32(pixels[m])
        few[RE + m], few[IM + m] = t[RE + j], t[IM + j]
        few[W + m], few[X + m], few[Y + m] = t[W + j], t[X + j], t[Y + j]
        few[EX + m], few[EY + m] = t[EX + j], t[EY + j]
        few[ERROR + m], few[SLOPE + m] = t[ERROR + j], t[SLOPE + j]


@inline
def _put_back(few: Any, pixels: Any, t: Any) -> None:
    """What another Newton step found."""
    for m in range(pixels.shape[0]):
        j = np.uint32(pixels[m])
        t[W + j], t[X + j], t[Y + j] = few[W + m], few[X + m], few[Y + m]
        t[ERROR + j], t[SLOPE + j], t[SIZE + j] = few[ERROR + m], few[SLOPE + m], few[SIZE + m]
        t[FRACTION + j], t[ACROSS + j] = few[FRACTION + m], few[ACROSS + m]
        t[SQUARE + j], t[VARIANCE + j] = few[SQUARE + m], few[VARIANCE + m]


@inline
def _store_points(t: Any, n: int, variance: Any, j0: int, stride: int, xyz: Any, sigma: Any, valid: Any) -> None:
    for j in range(n):
        z = _ONE / t[W + j]
        rx, ry = t[RX + j], t[RY + j]
        t[T0 + j] = z
        t[T1 + j] = root((variance[j] + t[VARIANCE + j]) * (rx * rx + ry * ry + _ONE)) / t[SLOPE + j] * z * z
    for j in range(n):
        valid[j] = np.uint8(t[OK + j] > _ZERO)
    if stride == 1:
        points, sigmas = xyz[j0 : j0 + n], sigma[j0 : j0 + n]
        for j in range(n):
            z = t[T0 + j]
            points[j, 0], points[j, 1], points[j, 2] = t[RX + j] * z, t[RY + j] * z, z
        for j in range(n):
            sigmas[j] = t[T1 + j]
        return
    for j in range(n):
        z, m = t[T0 + j], stride * (j0 + j)
        xyz[m, 0], xyz[m, 1], xyz[m, 2] = t[RX + j] * z, t[RY + j] * z, z
        sigma[m] = t[T1 + j]


@inline
def _store_places(t: Any, n: int, right_u: Any, right_v: Any, projector_u: Any, projector_v: Any) -> None:
    for j in range(n):
        right_u[j], right_v[j] = _steps_of_pixel(t[X + j]), _steps_of_pixel(t[Y + j])
    for j in range(n):
        projector_u[j], projector_v[j] = _steps_of_pixel(t[U + j]), _steps_of_pixel(t[V + j])


@inline
def _store_phases(t: Any, n: int, absolute_phase: Any, residual_normalised: Any, residual: Any) -> None:
    for j in range(n):
        residual_normalised[j], residual[j] = _steps_of_residual(t[T0 + j]), _steps_of_residual(t[T1 + j])
    for j in range(n):
        absolute_phase[j] = np.int16(np.int32(np.rint(t[PHI + j] * _PER_TURN)))


@inline
def _steps_of_pixel(x: Any) -> Any:
    """A coordinate in steps from the image's edge, see :mod:`pipeline.match.match_result`."""
    x = (x + _HALF) * _PER_PIXEL
    return np.uint16(np.int32(x if (x >= _ZERO) & (x < _FARTHEST) else _FARTHEST))


@inline
def _steps_of_residual(x: Any) -> Any:
    return np.int16(np.int32(np.rint(clamped(x * _PER_RADIAN, -_LARGEST, _LARGEST))))
