"""The order of every pixel from the lattice's confirmed orders, along continuous phase."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import inline, linked
from pipeline.common.parallel_for import blocks, parallel_allocating
from pipeline.decode.decoder import PhaseMap
from pipeline.fringe_order.left_right_check import UNDECIDED, flattened_row
from pipeline.geometry.view_tables import View

_TURN, _PER_TURN, _NAN = np.float32(2 * pi), np.float32(1 / (2 * pi)), np.float32(np.nan)
_FARTHEST = np.float32(2.2)
"""Deviation, radians, from which a lattice pixel's order is not taken."""
_PER_PIXEL = np.float32(0.15)
"""What a pixel of distance adds to that deviation, radians."""
_STRIPS = 8


def propagate(view: View, phases: PhaseMap, order: NDArray[np.int16], out: NDArray[np.int16]) -> None:
    """Write the order of every pixel to ``out`` (H, W), from those of the view's lattice (h, w)."""
    t = view.table
    slope_x, slope_y = np.float32(view.slopes[0]), np.float32(view.slopes[1])
    lowest = -t.top // t.down
    strips = (len(out) - 1 - t.top) // t.down - lowest + 1
    _propagate(
        blocks(strips, _STRIPS), order, t.top, t.down, t.left, t.step, phases.phase, phases.valid, slope_x, slope_y,
        lowest, strips, out,
    )  # fmt: skip


@linked
def _expanded(node: Any, step: int, before: int, out: Any) -> None:
    """Repeat each lattice pixel's value up to the next one, from column ``before`` on; NaN elsewhere."""
    out[:] = _NAN
    for b in range(node.shape[0]):
        for t in range(step):
            out[before + b * step + t] = node[b]


@inline
def _nearer_order(order: Any, least: Any, x: Any, distance: Any) -> tuple[Any, Any]:
    """The order that brings x closest to zero and its deviation, if that is less than the least so far."""
    m = np.rint(x * _PER_TURN)
    deviation = abs(x - _TURN * m) + distance
    return (m if deviation < least else order), (deviation if deviation < least else least)


@linked
def _least_deviating(
    expected: Any, valid: Any, upper: Any, upper_next: Any, lower: Any, lower_next: Any, distance: Any,
    distance_next: Any, down: Any, up: Any, out: Any,
) -> None:  # fmt: skip
    """Orders of a row from its four lattice neighbours; ``expected`` is the expected slope minus the phase."""
    for j in range(out.shape[0]):
        order, least = _nearer_order(np.float32(-32768.0), _FARTHEST, upper[j] + expected[j], distance[j] + down)
        order, least = _nearer_order(order, least, upper_next[j] + expected[j], distance_next[j] + down)
        order, least = _nearer_order(order, least, lower[j] + expected[j], distance[j] + up)
        order, least = _nearer_order(order, least, lower_next[j] + expected[j], distance_next[j] + up)
        out[j] = np.int16(np.int32(order)) if valid[j] else UNDECIDED


@parallel_allocating
def _propagate(
    block: int, order: Any, top: int, down: int, left: int, step: int, phase: Any, valid: Any, slope_x: Any,
    slope_y: Any, lowest: int, strips: int, out: Any,
) -> None:  # fmt: skip
    """Order of every pixel, ``out`` (H, W) int16, from the lattice pixels around it.

    A pixel takes the order of that one of its (up to four) decided neighbours whose phase continues to it with the
    least deviation; without such a neighbour it stays unknown.

    Args:
        lowest: lattice row at or above the image's first row; strips: between lattice rows, from that one on.
    """
    height, width = phase.shape
    h, w = order.shape
    before = step * ((left + step - 1) // step)
    offset = before - left
    node = np.empty(w, np.float32)
    wide = np.empty((2, max(width + offset, before + w * step) + step), np.float32)
    expected = np.empty(width, np.float32)
    distance, distance_next = np.empty(width, np.float32), np.empty(width, np.float32)
    for j in range(width):
        past = (j - left) % step
        distance[j], distance_next[j] = _PER_PIXEL * np.float32(past), _PER_PIXEL * np.float32(step - past)
    start = lowest + block * _STRIPS
    for a in range(start, min(start + _STRIPS, lowest + strips) + 1):
        # Lattice row a closes the strip that row a - 1 opens.
        if 0 <= a < h:
            flattened_row(order[a], top + down * a, left, step, phase, slope_x, slope_y, node)
            _expanded(node, step, before, wide[a % 2])
        else:
            wide[a % 2, :] = _NAN
        if a == start:
            continue
        upper, lower = wide[(a + 1) % 2, offset:], wide[a % 2, offset:]
        above = top + (a - 1) * down
        for i in range(max(above, 0), min(above + down, height)):
            for j in range(width):
                expected[j] = slope_x * np.float32(j) + slope_y * np.float32(i) - phase[i, j]
            _least_deviating(
                expected, valid[i], upper, upper[step:], lower, lower[step:], distance, distance_next,
                _PER_PIXEL * np.float32(i - above), _PER_PIXEL * np.float32(above + down - i), out[i],
            )  # fmt: skip
