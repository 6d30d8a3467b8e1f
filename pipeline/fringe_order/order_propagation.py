"""From the lattice's decisions to an order for every pixel: left/right agreement first, then phase continuity."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.common.jit import inline, parallel, prange, serial
from pipeline.decode.pixel_descriptor import bias_of

NONE = np.int16(-32768)
_TWO_PI = np.float32(2 * pi)
_PER_TURN = np.float32(1 / (2 * pi))
_NAN, _ZERO, _ONE = np.float32(np.nan), np.float32(0.0), np.float32(1.0)
_FARTHEST = np.float32(2.2)
"""Deviation, radians, from which no lattice pixel is followed."""
_PER_PIXEL = np.float32(0.15)
"""What a pixel of distance counts beside that deviation, radians."""
_STRIPS = 8


@serial
def _flattened(order: Any, i: int, left: int, step: int, phase: Any, slope_x: Any, slope_y: Any, out: Any) -> None:
    """Absolute phase of a lattice row's pixels less the expected slope, NaN where undecided."""
    down = slope_y * np.float32(i)
    for b in range(out.shape[0]):
        j = np.uint32(left + step * b)
        value = phase[i, j] + _TWO_PI * np.float32(order[b]) - slope_x * np.float32(j) - down
        out[b] = value if order[b] != NONE else _NAN


@serial
def _projector_places(
    order: Any, phase: Any, bias: Any, first: Any, per_step: Any, last: Any, absolute: Any, index: Any, part: Any
) -> None:  # fmt: skip
    """Absolute phases, and where in the table of projector coordinates they lie (integer and rest; NaN outside).

    The normalised phase (``bias`` more than the pointwise one) places a pixel; the other does where that falls off the
    table.
    """
    for b in range(absolute.shape[0]):
        plain = phase[b] + _TWO_PI * np.float32(order[b])
        x, spare = (plain + bias[b] - first) * per_step, (plain - first) * per_step
        x = x if (x >= _ZERO) & (x <= last) else spare
        inside = (x >= _ZERO) & (x <= last)
        safe = x if inside else _ZERO
        whole = np.int32(safe)
        whole = whole if whole < np.int32(last) else np.int32(last) - np.int32(1)
        absolute[b], index[b] = plain, whole
        part[b] = x - np.float32(whole) if inside else _NAN


@serial
def _other_places(low: Any, high: Any, part: Any, lines: Any, shift: Any, main: Any, side: Any) -> None:
    """Where the other camera sees the points of rays at the projector coordinates low + part (high - low).

    Args:
        lines: (7, w), of :class:`pipeline.geometry.ray_tables.RayTable`; shift: the column correction.
        main, side: results, along the growth of the phase and across it, pixels.
    """
    for b in range(main.shape[0]):
        u = low[b] + part[b] * (high[b] - low[b])
        u -= shift[0] + shift[1] * u + shift[2] * (lines[5, b] + lines[6, b] * u)
        place = (lines[0, b] + lines[1, b] * u) / (_ONE + lines[2, b] * u)
        main[b], side[b] = place, lines[3, b] + lines[4, b] * place


@serial
def _nearest(place: Any, first: Any, per_step: Any, count: int, out: Any) -> None:
    """Number of the lattice pixel nearest to a place, -1 more than one step outside."""
    most = np.float32(count)
    for b in range(out.shape[0]):
        x = np.rint((place[b] - first) * per_step)
        inside = (x >= -_ONE) & (x <= most)
        out[b] = np.int32(x if inside else _ZERO) if inside else np.int32(-9)


@parallel
def cross_check(
    order: Any, top: int, down: int, left: int, step: int, lines: Any, axis: int, phase: Any,
    descriptors: Any, other_order: Any, other_top: int, other_down: int, other_left: int, other_step: int,
    other_phase: Any, table: Any, shift: Any, slope_x: Any, slope_y: Any, limit: Any, kept: Any,
) -> None:  # fmt: skip
    """Orders (h, w) int16 kept where the other camera, asked from its own side, gives the same absolute phase there.

    Args:
        order, kept: (h, w) int16, the second is written; top .. step: place of the lattice in the image.
        lines: (7, h, w), of :class:`pipeline.geometry.ray_tables.RayTable`; axis: 0 = phase grows along u.
        phase, descriptors: of this image.
        other_order .. other_phase: the same of the other camera.
        table: even-grid table phase -> projector coordinate; shift: the column correction; all float32.
        slope_x, slope_y: the other image's expected phase steps per pixel.
    """
    h, w = order.shape
    n, m = other_order.shape
    # A border of two undecided pixels all around spares the tests for the lattice's end.
    seen = np.empty((n + 4, m + 4), np.float32)
    for p in prange(n + 4):
        seen[p, :] = _NAN
        if 2 <= p < n + 2:
            _flattened(other_order[p - 2], other_top + other_down * (p - 2), other_left, other_step, other_phase,
                       slope_x, slope_y, seen[p, 2 : m + 2])  # fmt: skip
    first, per_step = table[0], _ONE / table[1]
    last = np.float32(table.shape[0] - 3)
    r0, c0 = np.float32(other_top), np.float32(other_left)
    per_row, per_column = _ONE / np.float32(other_down), _ONE / np.float32(other_step)
    for a in prange(h):
        floats = np.empty((8, w), np.float32)
        here, bias, absolute, part, low, high = floats[0], floats[1], floats[2], floats[3], floats[4], floats[5]
        x, y = (floats[6], floats[7]) if axis == 0 else (floats[7], floats[6])
        index, p, q = np.empty(w, np.int32), np.empty(w, np.int32), np.empty(w, np.int32)
        i = top + down * a
        for b in range(w):
            j = np.uint32(left + step * b)
            here[b], index[b] = phase[i, j], descriptors[i, j]
        for b in range(w):
            bias[b] = bias_of(index[b], here[b])
        _projector_places(order[a], here, bias, first, per_step, last, absolute, index, part)
        for b in range(w):
            k = np.uint32(index[b] + 2)
            low[b], high[b] = table[k], table[k + np.uint32(1)]
        _other_places(low, high, part, lines[:, a], shift, floats[6], floats[7])
        _nearest(y, r0, per_row, n, p)
        _nearest(x, c0, per_column, m, q)
        for b in range(w):
            absolute[b] -= slope_x * x[b] + slope_y * y[b]
        for b in range(w):
            kept[a, b] = NONE
            if order[a, b] == NONE or p[b] < -1 or q[b] < -1:
                continue
            # The middle first: it nearly always decides.
            row, column, value = np.uint32(p[b] + 1), np.uint32(q[b] + 1), absolute[b]
            good = abs(seen[row + np.uint32(1), column + np.uint32(1)] - value) < limit
            for t in range(9):
                if good:
                    break
                good = abs(seen[row + np.uint32(t // 3), column + np.uint32(t % 3)] - value) < limit
            if good:
                kept[a, b] = order[a, b]


@serial
def _widened(node: Any, step: int, before: int, out: Any) -> None:
    """Each lattice pixel's value at the columns up to the next one, from ``before`` on; NaN elsewhere."""
    out[:] = _NAN
    for b in range(node.shape[0]):
        for t in range(step):
            out[before + b * step + t] = node[b]


@inline
def _nearer(turn: Any, least: Any, x: Any, away: Any) -> tuple[Any, Any]:
    """The order that takes x back to zero and its deviation, if that is less than the least so far."""
    m = np.rint(x * _PER_TURN)
    deviation = abs(x - _TWO_PI * m) + away
    return (m if deviation < least else turn), (deviation if deviation < least else least)


@serial
def _least_deviating(
    here: Any, valid: Any, upper: Any, upper_next: Any, lower: Any, lower_next: Any, away: Any, away_next: Any,
    down: Any, up: Any, out: Any,
) -> None:  # fmt: skip
    """Orders of a row from its four lattice neighbours; ``here`` is the expected slope less the phase."""
    for j in range(out.shape[0]):
        turn, least = _nearer(np.float32(-32768.0), _FARTHEST, upper[j] + here[j], away[j] + down)
        turn, least = _nearer(turn, least, upper_next[j] + here[j], away_next[j] + down)
        turn, least = _nearer(turn, least, lower[j] + here[j], away[j] + up)
        turn, least = _nearer(turn, least, lower_next[j] + here[j], away_next[j] + up)
        out[j] = np.int16(np.int32(turn)) if valid[j] else NONE


@parallel
def spread(
    order: Any, top: int, down: int, left: int, step: int, phase: Any, valid: Any, slope_x: Any, slope_y: Any, out: Any
) -> None:
    """Order of every pixel, ``out`` (H, W) int16, from the lattice pixels around it.

    Among the (up to four) decided neighbours the one whose phase continues to this pixel with the least deviation is
    followed; a pixel without any stays unknown. Arguments as in :func:`cross_check`.
    """
    height, width = phase.shape
    h, w = order.shape
    lowest = (0 - top) // down
    strips = (height - 1 - top) // down - lowest + 1
    before = step * ((left + step - 1) // step)
    offset = before - left
    for block in prange((strips + _STRIPS - 1) // _STRIPS):
        node = np.empty(w, np.float32)
        wide = np.empty((2, max(width + offset, before + w * step) + step), np.float32)
        here = np.empty(width, np.float32)
        away, away_next = np.empty(width, np.float32), np.empty(width, np.float32)
        for j in range(width):
            past = (j - left) % step
            away[j], away_next[j] = _PER_PIXEL * np.float32(past), _PER_PIXEL * np.float32(step - past)
        start = lowest + block * _STRIPS
        for a in range(start, min(start + _STRIPS, lowest + strips) + 1):
            # Lattice row a closes the strip that row a - 1 opens.
            if 0 <= a < h:
                _flattened(order[a], top + down * a, left, step, phase, slope_x, slope_y, node)
                _widened(node, step, before, wide[a % 2])
            else:
                wide[a % 2, :] = _NAN
            if a == start:
                continue
            upper, lower = wide[(a + 1) % 2, offset:], wide[a % 2, offset:]
            above = top + (a - 1) * down
            for i in range(max(above, 0), min(above + down, height)):
                for j in range(width):
                    here[j] = slope_x * np.float32(j) + slope_y * np.float32(i) - phase[i, j]
                _least_deviating(
                    here, valid[i], upper, upper[step:], lower, lower[step:], away, away_next,
                    _PER_PIXEL * np.float32(i - above), _PER_PIXEL * np.float32(above + down - i), out[i],
                )  # fmt: skip
