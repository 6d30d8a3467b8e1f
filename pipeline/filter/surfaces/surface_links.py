"""Links of neighbouring pixels whose absolute phase and match continue: what makes them one surface."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.common.connected_components import LEFT, UP
from pipeline.common.jit import linked
from pipeline.common.parallel_for import parallel
from pipeline.match.match_result import PIXEL_STEPS, TURN_STEPS

_NO = np.uint8(0)
_PHASE_STEP = int(1.2 / (2 * pi) * TURN_STEPS)
_MATCH_STEP = int(1.5 * PIXEL_STEPS)


@linked
def _continues(
    a: Any, b: Any, a_u: Any, b_u: Any, a_v: Any, b_v: Any, step: Any, du: int, dv: int, bit: Any, out: Any
) -> None:  # fmt: skip
    """Add a bit to ``out`` where row ``a`` goes on from ``b`` by about the expected steps.

    Differences are taken modulo 16 bits; shifted by their limit they are small numbers without sign.
    """
    for j in range(out.shape[0]):
        near = np.uint16(a[j] - b[j] - step + _PHASE_STEP) <= np.uint16(2 * _PHASE_STEP)
        near &= np.uint16(a_u[j] - b_u[j] - du + _MATCH_STEP) <= np.uint16(2 * _MATCH_STEP)
        near &= np.uint16(a_v[j] - b_v[j] - dv + _MATCH_STEP) <= np.uint16(2 * _MATCH_STEP)
        out[j] |= bit if near else _NO


@parallel
def links(i: int, absolute_phase: Any, right_u: Any, right_v: Any, slope_x: int, slope_y: int, out: Any) -> None:
    """Bits LEFT and UP of every pixel into ``out`` (H, W) uint8; of no meaning beside unknown pixels.

    Args:
        absolute_phase: (H, W) int16; right_u, right_v: (H, W) int16, pixel in the right image, all in the steps of
            :mod:`pipeline.match.match_result`, modulo 16 bits.
        slope_x, slope_y: expected change of the phase per pixel, steps.
    """
    width = absolute_phase.shape[1]
    last = width - 1
    a, u, v = absolute_phase[i], right_u[i], right_v[i]
    out[i, :] = _NO
    _continues(a[1:], a[:last], u[1:], u[:last], v[1:], v[:last], slope_x, PIXEL_STEPS, 0, LEFT, out[i, 1:])
    if i > 0:
        _continues(a, absolute_phase[i - 1], u, right_u[i - 1], v, right_v[i - 1], slope_y, 0, PIXEL_STEPS, UP, out[i])
