"""Second harmonic of the fringes of a projector whose response is not calibrated.

Four steps measure the phase in spite of it, but their residual is this harmonic, which must not be taken for motion: it
advances by twice the phase and is the same all over the image.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.multi_frame.image_roles import Plan, Shifted

F64 = NDArray[np.float64]
_EVERY = 8
_LARGEST = 0.3
_FEWEST = 200


def second_harmonics(plan: Plan, stack: NDArray[Any], channels: int, min_amplitude: float) -> F64:
    """(J, 2), for each fringe of four steps the ``harmonic`` of ``n_step_kernel.phases``."""
    out = np.zeros((len(plan.fringes), 2))
    for q, fringe in enumerate(plan.fringes):
        if fringe.harmonic:
            out[q] = _second_harmonic(
                fringe, stack[:, _EVERY // 2 :: _EVERY, channels // 2 :: _EVERY * channels], min_amplitude
            )
    return out


def _second_harmonic(fringe: Shifted, some: NDArray[Any], min_amplitude: float) -> F64:
    values = np.stack([some[n].ravel() for n in fringe.frames]).astype(np.float64)
    full = 255.0 if some.dtype == np.uint8 else 65535.0
    _, re, im = fringe.solve @ values
    size = np.hypot(re, im)
    lit = (size * 255 / full >= min_amplitude) & (values.max(axis=0) < 0.99 * full)
    residual = (fringe.rest[0] @ values)[lit] / size[lit]
    double = ((re + 1j * im)[lit] / size[lit]) ** 2
    small = np.abs(residual) < _LARGEST
    if np.count_nonzero(small) < _FEWEST:
        return np.zeros(2)
    design = np.stack([double.real, -double.imag], axis=1)[small]
    return np.asarray(np.linalg.lstsq(design, residual[small], rcond=None)[0])
