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
_PHASE, _NORMALISED, _MEAN = np.int32(-(2**20)), np.int32(-(2**21)), np.int32(255)
_REST = np.int32(_PHASE | VALID)  # all but the normalised phase and the mean
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
def correct_descriptors(i: int, phases: Any, means: Any, descriptors: Any) -> None:
    """Correct normalised phases and means of row i of descriptors (H, W) by the tables of :func:`correction_tables`."""
    row = descriptors[i]
    for j in range(row.shape[0]):
        x = row[j]
        phase = phases[np.int32(x >> np.int32(9)) & np.int32(0x7FF)]
        row[j] = np.int32(np.int32(x & _REST) | np.int32(phase | means[x & _MEAN]))


def correction_tables(error: NDArray[np.float64], brightness: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Bits of every normalised phase less its error (2048,) and of every mean divided by the brightness (256,).

    Args:
        error: (6,) radians, see :func:`periodic`; brightness: cameras of unequal brightness become comparable so.
    """
    phases = np.arange(2**11) / np.float64(_NORMALISED_STEPS)
    steps = np.rint((phases - periodic(phases) @ error) * np.float64(_NORMALISED_STEPS)).astype(np.int64)
    means = np.minimum(np.rint(np.arange(256) / brightness), 255)
    return ((steps & 0x7FF) << 9).astype(np.int32), means.astype(np.int32)


def periodic(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 6) cosine and sine of one, two and three times the phases (n,): the coefficients of a periodic error."""
    return np.stack([f(k * phase) for k in (1, 2, 3) for f in (np.cos, np.sin)], axis=-1)


def normalised_phase(descriptors: NDArray[np.int32]) -> NDArray[np.float32]:
    """Normalised phases of descriptors, radians."""
    return np.asarray(((descriptors << 12) & _NORMALISED) * RADIANS, dtype=np.float32)
