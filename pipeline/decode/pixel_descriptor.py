"""Pixel descriptors: what the order search compares of a pixel, in four bytes, so that one look-up is enough.

From the highest bit: 12 bits of the pointwise phase and 11 of the normalised one, fractions of a turn that wrap as
phases do; one bit for a valid pixel; 8 bits of the mean, counts. The phases are rounded by 1.5 milliradians at most, a
thirtieth of their noise.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import inline, serial
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import angle, whole_turns

VALID = np.int32(256)
RADIANS = np.float32(2 * pi / 2**32)
"""One unit of :func:`phase_units` and :func:`normalised_units`: 2^32 are a turn, so that differences wrap."""
EVEN = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""The factor 1 at every place of an image, see :func:`over_the_image`."""
_PHASE, _NORMALISED, _MEAN = np.int32(-(2**20)), np.int32(-(2**21)), np.int32(255)
_REST = np.int32(_PHASE | VALID)  # all but the normalised phase and the mean
_HALF, _ONE, _TWO = np.float32(0.5), np.float32(1.0), np.float32(2.0)
_TURN, _FINE = np.float32(2 * pi), np.float32(2**28 / (2 * pi))
_PHASE_STEPS, _NORMALISED_STEPS = np.float32(2**12 / (2 * pi)), np.float32(2**11 / (2 * pi))


@inline
def phase_units(x: Any) -> Any:
    """The pointwise phase of a pixel's descriptor."""
    return np.int32(x & _PHASE)


@inline
def normalised_units(x: Any) -> Any:
    """The normalised phase of a pixel's descriptor."""
    return np.int32(np.int32(x << np.int32(12)) & _NORMALISED)


@inline
def mean_of(x: Any) -> Any:
    """The mean of a pixel's descriptor, counts."""
    return np.float32(np.int32(x & _MEAN))


@inline
def units(phase: Any) -> Any:
    """A wrapped phase, radians, in units."""
    return np.int32(np.int32(np.rint(phase * _FINE)) << np.int32(4))


@inline
def bias_of(x: Any, phase: Any) -> Any:
    """Normalised phase of a pixel's descriptor minus its pointwise phase, -pi .. pi radians."""
    d = np.float32(normalised_units(x)) * RADIANS - phase
    return d - _TURN * whole_turns(d)


@inline
def _normalised_bits(phase: Any) -> Any:
    return np.int32(np.int32(np.int32(np.rint(phase * _NORMALISED_STEPS)) & np.int32(0x7FF)) << np.int32(9))


@serial
def normalised_phase_row(re: Any, im: Any, out: Any) -> None:
    """Descriptors (n,) int32 with only the phase of normalised phasors (n,)."""
    for j in range(out.shape[0]):
        out[j] = _normalised_bits(angle(re[j], im[j]))


@serial
def complete_row(phase: Any, valid: Any, mean: Any, out: Any) -> None:
    """Add to :func:`normalised_phase_row`: phase (n,) radians, valid (n,) bool, mean (n,) uint8."""
    for j in range(out.shape[0]):
        q = np.int32(np.int32(np.rint(phase[j] * _PHASE_STEPS)) << np.int32(20))
        fine = VALID if valid[j] else np.int32(0)
        out[j] = np.int32(np.int32(out[j] | q) | np.int32(fine | np.int32(mean[j])))


@parallel
def descriptors_without_color(i: int, phase: Any, valid: Any, mean: Any, out: Any) -> None:
    """Descriptors (H, W) of images in which both phases are the same; the others as in :func:`complete_row`."""
    for j in range(out.shape[1]):
        out[i, j] = _normalised_bits(phase[i, j])
    complete_row(phase[i], valid[i], mean[i], out[i])


@parallel
def correct_descriptors(i: int, phases: Any, factor: Any, descriptors: Any) -> None:
    """Correct normalised phases and means of row i of descriptors (H, W).

    Args:
        phases: of :func:`correction_table`.
        factor: (7,) float32 that means are multiplied by, see :func:`over_the_image`: it makes cameras comparable.
    """
    height, width = descriptors.shape
    row, step, y = descriptors[i], _TWO / np.float32(width - 1), _TWO * np.float32(i) / np.float32(height - 1) - _ONE
    constant, slope = factor[0] + y * (factor[2] + y * factor[5]), factor[1] + y * factor[4]
    curvature, radial, beside = factor[3], factor[6], y * y
    for j in range(width):
        pixel, x = row[j], step * np.float32(j) - _ONE
        phase = phases[np.int32(pixel >> np.int32(9)) & np.int32(0x7FF)]
        square = x * x + beside
        mean = mean_of(pixel) * (constant + x * (slope + x * curvature) + radial * square * square) + _HALF
        bits = np.int32(min(max(mean, _HALF), np.float32(_MEAN)))
        row[j] = np.int32(np.int32(pixel & _REST) | np.int32(phase | bits))


def correction_table(error: NDArray[np.float64]) -> NDArray[np.int32]:
    """Bits of every normalised phase (2048,) less its error (6,), radians, see :func:`periodic`."""
    phases = np.arange(2**11) / np.float64(_NORMALISED_STEPS)
    steps = np.rint((phases - periodic(phases) @ error) * np.float64(_NORMALISED_STEPS)).astype(np.int64)
    return ((steps & 0x7FF) << 9).astype(np.int32)


def over_the_image(u: NDArray[Any], v: NDArray[Any], size: tuple[int, int]) -> NDArray[np.float64]:
    """(n, 7) terms 1, x, y, x^2, x y, y^2, (x^2 + y^2)^2 of a function of the place in an image, x and y from -1 to 1.

    Args:
        u, v: (n,) pixels; size: (width, height).
    """
    x, y = 2.0 * u / (size[0] - 1) - 1, 2.0 * v / (size[1] - 1) - 1
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, (x * x + y * y) ** 2], axis=-1)


def periodic(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 6) cosine and sine of one, two and three times the phases (n,): the coefficients of a periodic error."""
    return np.stack([f(k * phase) for k in (1, 2, 3) for f in (np.cos, np.sin)], axis=-1)


def normalised_phase(descriptors: NDArray[np.int32]) -> NDArray[np.float32]:
    """Normalised phases of descriptors, radians."""
    return np.asarray(((descriptors << 12) & _NORMALISED) * RADIANS, dtype=np.float32)


def corrected_mean(descriptors: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Means of descriptors, counts."""
    return (descriptors & _MEAN).astype(np.uint8)
