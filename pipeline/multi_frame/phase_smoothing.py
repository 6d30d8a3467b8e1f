"""Absolute phases averaged over 3 x 3 pixels with binomial weights (1 2 1).

On a Bayer mosaic every such window holds red, green and blue as 1 : 2 : 1: chromatic differences (lenses,
misregistered projector colours) are then the same in all pixels and in both cameras. A neighbour is used only together
with the opposite one, and only where both lie on the pixel's surface: the average of opposite neighbours has no slope
error.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import parallel
from pipeline.decode.packed_phasor import PHASOR_SCALE, pack
from pipeline.multi_frame.temporal_unwrapping import NONE, UNIT

CORRELATION = 2 / 3
"""Of neighbouring pixels' noise afterwards."""
_MAX_CURVATURE = np.float32(0.8)
_ZERO, _TWO, _FOUR, _TURN = np.float32(0), np.float32(2), np.float32(4), np.float32(2 * np.pi)


@parallel
def smooth(
    i: int, absolute_phase: Any, variance: Any, order: Any, phase: Any, phasor: Any, out: Any, out_variance: Any
) -> None:
    """Average ``absolute_phase`` (H, W), NaN where unknown, into ``out``, with its variance in ``out_variance``.

    ``phase`` becomes the average minus the order's whole turns, ``phasor`` (H, W) int32 its packed phasor.
    """
    height, width = absolute_phase.shape
    for j in range(width):
        middle = absolute_phase[i, j]
        out[i, j], out_variance[i, j] = middle, variance[i, j]
        if order[i, j] == NONE:
            continue
        total, weight, noise = _FOUR * middle, _FOUR, _FOUR * _FOUR * variance[i, j]
        if 0 < i < height - 1 and 0 < j < width - 1:
            for pair in range(4):
                # Right, below, and the two diagonals, each with its opposite.
                y, x = (0 if pair == 0 else 1), (0 if pair == 1 else (1 if pair != 3 else -1))
                share = _TWO if pair < 2 else np.float32(1)
                a, b = absolute_phase[i + y, j + x], absolute_phase[i - y, j - x]
                # False where one of them is unknown.
                if abs(a + b - _TWO * middle) < _MAX_CURVATURE and abs(a - b) < _FOUR:
                    total += share * (a + b)
                    weight += _TWO * share
                    noise += share * share * (variance[i + y, j + x] + variance[i - y, j - x])
        found = total / weight
        out[i, j], out_variance[i, j] = found, noise / (weight * weight)
        rest = found - _TURN * np.float32(order[i, j])
        phase[i, j] = rest
        phasor[i, j] = pack(UNIT * np.cos(rest), UNIT * np.sin(rest), PHASOR_SCALE)


@parallel
def blend(i: int, plane: Any, out: Any) -> None:
    """The same average of a plane (H, W) float32 that is valid everywhere; borders unchanged."""
    height, width = plane.shape
    for j in range(width):
        if i == 0 or j == 0 or i == height - 1 or j == width - 1:
            out[i, j] = plane[i, j]
            continue
        total = _FOUR * plane[i, j]
        total += _TWO * (plane[i - 1, j] + plane[i + 1, j] + plane[i, j - 1] + plane[i, j + 1])
        total += plane[i - 1, j - 1] + plane[i - 1, j + 1] + plane[i + 1, j - 1] + plane[i + 1, j + 1]
        out[i, j] = total * np.float32(1 / 16)
