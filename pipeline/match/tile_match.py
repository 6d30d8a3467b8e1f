"""The sub-pixel match of one tile of pixels, from their orders to their points.

Everything is done for tiles (see :mod:`pipeline.common.tile_math`). Two samples of the other image suffice for nine
pixels in ten; the others are gathered for a third one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.match.epipolar_search import (  # isort: skip
    ACROSS, BIAS, ERROR, EX, EY, FEW, FRACTION, IM, INTEGER_SLOTS, OK, PHI, RE, RX, RY, SIZE, SLOPE, SLOTS, SQUARE, T0,
    T1, U, V, VARIANCE, W, X, Y, columns_of, errors, evidence, look_up, meet, move, pixel, projected_phase, ray,
)  # fmt: skip
from pipeline.common.jit import allocating, inline, linked
from pipeline.common.tile_math import TILE, clamped, root
from pipeline.decode.packed_phasor import imaginary, real
from pipeline.decode.pixel_descriptor import bias_of
from pipeline.match.match_result import LARGEST_RESIDUAL, OUTSIDE, PIXEL_STEPS, RESIDUAL_STEP, TURN_STEPS

F32 = NDArray[np.float32]

_COHERENCE_SQ = np.float32(0.16)
_CONVERGED = np.float32(0.1)
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_TURN = np.float32(2 * np.pi)
_PER_PIXEL, _FARTHEST = np.float32(PIXEL_STEPS), np.float32(OUTSIDE)
_PER_RADIAN, _LARGEST = np.float32(1 / RESIDUAL_STEP), np.float32(LARGEST_RESIDUAL)
_PER_TURN = np.float32(TURN_STEPS / (2 * np.pi))


class MatchModel(NamedTuple):
    """What the match needs to know of the rig; all arrays float32.

    Args:
        device: packed model of the other camera; width, height: of its image.
        projector: packed model of the projector; axis: 0 = phase grows along u.
        base, span: 1/z = base + span s; least, most: limits of s, beyond which there are no points.
        columns: even-grid table phase -> projector coordinate; phases: phase at each projector coordinate;
            linear: both are straight lines.
        correction: of the projector's columns.
        floor_sq: least squared size of a packed phasor.
        correlation: of neighbouring phases' noise in the other image (0 pointwise, more after a window fit).
        blur: by which the other camera's fringes have less contrast, as a share of theirs.
    """

    device: F32
    width: int
    height: int
    projector: F32
    axis: int
    base: np.float32
    span: np.float32
    least: np.float32
    most: np.float32
    columns: F32
    phases: F32
    linear: bool
    correction: F32
    floor_sq: np.float32
    correlation: np.float32
    blur: np.float32


@allocating
def scratch() -> tuple[Any, Any, Any, Any, Any]:
    """Arrays of a tile, of a tile of few pixels, and of pixel numbers, for :func:`match_tile`."""
    return (
        np.zeros(SLOTS * TILE, np.float32),
        np.zeros(INTEGER_SLOTS * TILE, np.int32),
        np.zeros(SLOTS * TILE, np.float32),
        np.zeros(INTEGER_SLOTS * TILE, np.int32),
        np.empty(TILE, np.int32),
    )


@linked
def match_tile(arrays: Any, n: int, model: Any, other: Any, variance: Any) -> None:
    """Match the first n pixels of a loaded tile (see :func:`load`), for the functions ``store_...``.

    Args:
        arrays: of :func:`scratch`; slot OK is 1 where there is an order.
        other, variance: phasors, packed, and phase variances of the other image, flat.
    """
    t, k, few, few_k, again = arrays
    device, projector, axis, correction = model.device, model.projector, model.axis, model.correction
    other_width, other_height = model.width, model.height
    along, across = (1, other_width) if axis == 0 else (other_width, 1)
    delta = np.float32(0.01 * model.span)
    loss = _TWO * (_ONE - model.correlation)
    columns_of(t, k, model.columns, model.linear)
    meet(t, projector, axis, correction)
    for j in range(TILE):
        ax, ay, az = ray(t, device, j)
        w = t[W + j]
        x, y = pixel(device, ax, ay, az, w)
        x1, y1 = pixel(device, ax, ay, az, w + delta)
        t[X + j], t[Y + j] = x, y
        t[EX + j], t[EY + j] = (x1 - x) / delta, (y1 - y) / delta
        t[T0 + j] = w
    look_up(t, k, other, along, across, other_width, other_height, TILE)
    errors(t, axis, model.blur, TILE)
    move(t, TILE)
    look_up(t, k, other, along, across, other_width, other_height, TILE)
    errors(t, axis, model.blur, TILE)
    evidence(t, k, variance, along, across, TILE)
    left = 0
    for j in range(n):
        again[left] = j
        left += (t[OK + j] > _ZERO) & (abs(t[ERROR + j]) >= _CONVERGED)
    # Most of these are at the border of something, and few: often one sample for all of them.
    for o in range(0, left, FEW):
        some = again[o : min(o + FEW, left)]
        _gather(t, some, few)
        move(few, FEW)
        look_up(few, few_k, other, along, across, other_width, other_height, FEW)
        errors(few, axis, model.blur, FEW)
        evidence(few, few_k, variance, along, across, FEW)
        _put_back(few, some, t)
    for j in range(TILE):
        f, slope, ex, ey = t[ERROR + j], t[SLOPE + j], t[EX + j], t[EY + j]
        x, y, size = t[X + j], t[Y + j], t[SIZE + j]
        good = (abs(f) < _CONVERGED) & (size >= model.floor_sq) & (size > _COHERENCE_SQ * t[SQUARE + j])
        good &= abs(t[W + j] - t[T0 + j]) * abs(slope) < np.float32(3.0)
        by = -f / slope
        w = t[W + j] + by
        x, y = x + ex * by, y + ey * by  # far where the phase hardly changes
        good &= (x >= _ONE) & (y >= _ONE)
        good &= (x < np.float32(other_width - 2)) & (y < np.float32(other_height - 2))
        s = (w - model.base) / model.span
        good &= (s > model.least) & (s < model.most)
        a, b = t[FRACTION + j], t[ACROSS + j]
        v = t[VARIANCE + j] * (_ONE - loss * a * (_ONE - a)) * (_ONE - loss * b * (_ONE - b))
        good &= v < _ONE
        active = t[OK + j]
        t[OK + j] = active if good else _ZERO
        t[W + j] = w
        t[X + j], t[Y + j] = x, y
        t[VARIANCE + j] = v
        t[SLOPE + j] = abs(slope)
    for j in range(TILE):
        ax, ay, az = ray(t, projector, j)
        t[U + j], t[V + j] = pixel(projector, ax, ay, az, t[W + j])
    projected_phase(t, k, axis, model.phases, model.linear, correction)
    for j in range(TILE):
        t[T1 + j] = t[PHI + j] - t[T0 + j]
        t[T0 + j] = t[T1 + j] + t[BIAS + j]


@inline
def load(t: Any, n: int, order: Any, phase: Any, descriptors: Any, phasor: Any, rays_x: Any, rays_y: Any) -> None:
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
        few[ERROR + m], few[SLOPE + m], few[BIAS + m] = t[ERROR + j], t[SLOPE + j], t[BIAS + j]


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
def store_points(t: Any, n: int, variance: Any, j0: int, stride: int, xyz: Any, sigma: Any, valid: Any) -> None:
    """Write points, sigmas and validity of a tile whose first pixel is number ``j0`` of its row; mm."""
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
def store_places(t: Any, n: int, right_u: Any, right_v: Any, projector_u: Any, projector_v: Any) -> None:
    """Write the pixels of a tile in the other camera and in the projector, in steps."""
    for j in range(n):
        right_u[j], right_v[j] = _steps_of_pixel(t[X + j]), _steps_of_pixel(t[Y + j])
    for j in range(n):
        projector_u[j], projector_v[j] = _steps_of_pixel(t[U + j]), _steps_of_pixel(t[V + j])


@inline
def store_phases(t: Any, n: int, absolute_phase: Any, residual_normalised: Any, residual: Any) -> None:
    """Write absolute phases and residuals of a tile, in steps."""
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
