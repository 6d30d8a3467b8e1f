"""Output of the decoders, row by row, and the stride of their scratch rows."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from pipeline.common.jit import linked
from pipeline.common.tile_math import angle
from pipeline.decode.packed_phasor import pack

_LINE = 16  # float32 in a cache line
_ZERO, _MOST = np.float32(0.0), np.float32(255.0)


@linked
def row_stride(width: int) -> int:
    """Elements from one scratch row to the next.

    An odd number of cache lines: with a power of two all rows would compete for the same cache sets.
    """
    return _LINE * (width // _LINE + 1 + (width // _LINE) % 2)


@linked
def angles_of_row(re: Any, im: Any, scale: Any, phasor: Any, phase: Any) -> None:
    """Phasors (n,) to a packed row (n,) int32 and their angles (n,) float32."""
    for j in range(phase.shape[0]):
        phase[j] = angle(re[j], im[j])
    for j in range(phase.shape[0]):
        phasor[j] = pack(re[j], im[j], scale)


@linked
def copy_row(values: Any, out: Any) -> None:
    """Copy a row (n,); numba compiles the message of a slice's wrong shape for 4 s."""
    for j in range(out.shape[0]):
        out[j] = values[j]


@linked
def describe_row(re: Any, im: Any, variance: Any, min_modulation: float, modulation: Any, valid: Any) -> None:
    """Modulation (n,) uint8 counts and validity (n,) bool of a row."""
    full, one = np.float32(255.0), np.float32(1.0)
    for j in range(modulation.shape[0]):
        size = np.float32(sqrt(re[j] * re[j] + im[j] * im[j]))
        modulation[j] = np.uint8(np.int32(min(size, full)))
        valid[j] = (size >= min_modulation) & (variance[j] < one)


@linked
def counts_of_row(mean: Any, out: Any) -> None:
    """Means (n,) float32 to whole counts 0 .. 255, (n,) uint8."""
    for j in range(out.shape[0]):
        x = np.rint(mean[j])
        x = x if x > _ZERO else _ZERO
        out[j] = np.uint8(np.int32(x if x < _MOST else _MOST))
