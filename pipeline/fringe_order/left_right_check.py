"""Left-right check: orders of one view's lattice that the search from the other view confirms."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import linked
from pipeline.common.parallel_for import blocks, parallel, parallel_allocating
from pipeline.decode.decoder import PhaseMap
from pipeline.decode.pixel_descriptor import bias_of
from pipeline.fringe_order.semi_global_aggregation import NONE
from pipeline.geometry.view_tables import View

_TURN = np.float32(2 * pi)
UNDECIDED = np.int16(NONE)
ROWS = 8
"""Lattice rows that share scratch arrays."""
_NAN, _ZERO, _ONE = np.float32(np.nan), np.float32(0.0), np.float32(1.0)


def cross_check(
    view: View, phases: PhaseMap, order: NDArray[np.int16], other: View, other_phases: PhaseMap,
    other_order: NDArray[np.int16], correction: NDArray[np.float64], confirmed: NDArray[np.int16],
    place: NDArray[np.int32],
) -> None:  # fmt: skip
    """Write the orders (h, w) of a view's lattice that the other view confirms to ``confirmed``, NONE elsewhere.

    ``place`` (h, w) becomes the number of the other lattice's pixel to which each order leads, -1 = none.
    """
    t, o = view.table, other.table
    n, m = other_order.shape
    # With a border of two undecided pixels no access needs a test for the lattice's end.
    other_absolute = np.empty((n + 4, m + 4), np.float32)
    slopes = np.float32(other.slopes[0]), np.float32(other.slopes[1])
    _other_absolute_row(n + 4, other_order, o.top, o.down, o.left, o.step, other_phases.phase, *slopes, other_absolute)
    _cross_check(
        blocks(len(order), ROWS), order, t.top, t.down, t.left, t.step, t.lines, view.first_axis, phases.phase,
        phases.descriptors, other_absolute, o.top, o.down, o.left, o.step, view.phase_to_column,
        correction.astype(np.float32), *slopes, np.float32(view.settings.consistency_threshold), confirmed, place,
    )  # fmt: skip


@linked
def flattened_row(order: Any, i: int, left: int, step: int, phase: Any, slope_x: Any, slope_y: Any, out: Any) -> None:
    """Absolute phase of a lattice row's pixels less the expected slope, NaN where undecided."""
    down = slope_y * np.float32(i)
    for b in range(out.shape[0]):
        j = np.uint32(left + step * b)
        value = phase[i, j] + _TURN * np.float32(order[b]) - slope_x * np.float32(j) - down
        out[b] = value if order[b] != UNDECIDED else _NAN


@linked
def _projector_positions(
    order: Any, phase: Any, bias: Any, first: Any, per_step: Any, last: Any, absolute: Any, index: Any, part: Any
) -> None:  # fmt: skip
    """Absolute phases, and their positions in the table of projector coordinates (integer and rest; NaN outside).

    The normalised phase (the pointwise one plus ``bias``) gives a pixel's position; the pointwise one does where the
    normalised one lies outside the table.
    """
    for b in range(absolute.shape[0]):
        plain = phase[b] + _TURN * np.float32(order[b])
        x, fallback = (plain + bias[b] - first) * per_step, (plain - first) * per_step
        x = x if (x >= _ZERO) & (x <= last) else fallback
        inside = (x >= _ZERO) & (x <= last)
        clamped = x if inside else _ZERO
        cell = np.int32(clamped)
        cell = cell if cell < np.int32(last) else np.int32(last) - np.int32(1)
        absolute[b], index[b] = plain, cell
        part[b] = x - np.float32(cell) if inside else _NAN


@linked
def _other_positions(
    low: Any, high: Any, part: Any, lines: Any, a: int, correction: Any, main: Any, side: Any
) -> None:  # fmt: skip
    """Pixels of the other camera that see the points of rays at the projector coordinates low + part (high - low).

    Args:
        lines: (7, h, w), of :class:`pipeline.geometry.ray_tables.RayTable`; a: lattice row.
        correction: the column correction.
        main, side: results, along the growth of the phase and across it, pixels.
    """
    m0, m1, m2, q0, q1, r0, r1 = (
        lines[0, a], lines[1, a], lines[2, a], lines[3, a], lines[4, a], lines[5, a], lines[6, a],
    )  # fmt: skip
    c0, c1, c2 = correction[0], correction[1], correction[2]
    for b in range(main.shape[0]):
        u = low[b] + part[b] * (high[b] - low[b])
        u -= c0 + c1 * u + c2 * (r0[b] + r1[b] * u)
        along = (m0[b] + m1[b] * u) / (_ONE + m2[b] * u)
        main[b], side[b] = along, q0[b] + q1[b] * along


@linked
def _nearest(pixel: Any, first: Any, per_step: Any, count: int, out: Any) -> None:
    """Index of the lattice row or column nearest to a pixel coordinate, -9 where that is more than one step outside."""
    last = np.float32(count)
    for b in range(out.shape[0]):
        x = np.rint((pixel[b] - first) * per_step)
        inside = (x >= -_ONE) & (x <= last)
        out[b] = np.int32(x if inside else _ZERO) if inside else np.int32(-9)


@parallel
def _other_absolute_row(
    p: int, order: Any, top: int, down: int, left: int, step: int, phase: Any, slope_x: Any, slope_y: Any, out: Any
) -> None:
    """Row p of the flattened absolute phases with a border of two undecided pixels, ``out`` (h + 4, w + 4)."""
    n, m = order.shape
    out[p, :] = _NAN
    if 2 <= p < n + 2:
        flattened_row(order[p - 2], top + down * (p - 2), left, step, phase, slope_x, slope_y, out[p, 2 : m + 2])


@parallel_allocating
def _cross_check(
    block: int, order: Any, top: int, down: int, left: int, step: int, lines: Any, axis: int, phase: Any,
    descriptors: Any, other_absolute: Any, other_top: int, other_down: int, other_left: int, other_step: int,
    table: Any, correction: Any, slope_x: Any, slope_y: Any, limit: Any, confirmed: Any, place: Any,
) -> None:  # fmt: skip
    """Keep orders of :data:`ROWS` lattice rows that lead to the phase which the other camera's search finds there.

    Args:
        order, confirmed: (h, w) int16, the second is written; top .. step: position of the lattice in the image.
        place: (h, w) int32, written, see :func:`cross_check`.
        lines: (7, h, w), of :class:`pipeline.geometry.ray_tables.RayTable`; axis: 0 = phase grows along u.
        phase, descriptors: of this image.
        other_absolute: of :func:`_other_absolute_row`; other_top .. other_step: position of the other lattice.
        table: even-grid table phase -> projector coordinate; correction: of the columns; all float32.
        slope_x, slope_y: the other image's expected phase steps per pixel.
    """
    w = order.shape[1]
    n, m = other_absolute.shape[0] - 4, other_absolute.shape[1] - 4
    first, per_step = table[0], _ONE / table[1]
    last = np.float32(table.shape[0] - 3)
    r0, c0 = np.float32(other_top), np.float32(other_left)
    per_row, per_column = _ONE / np.float32(other_down), _ONE / np.float32(other_step)
    floats = np.empty((8, w), np.float32)
    wrapped, bias, absolute, part, low, high = floats[0], floats[1], floats[2], floats[3], floats[4], floats[5]
    x, y = (floats[6], floats[7]) if axis == 0 else (floats[7], floats[6])
    index, p, q = np.empty(w, np.int32), np.empty(w, np.int32), np.empty(w, np.int32)
    for a in range(block * ROWS, min((block + 1) * ROWS, order.shape[0])):
        i = top + down * a
        for b in range(w):
            j = np.uint32(left + step * b)
            wrapped[b], index[b] = phase[i, j], descriptors[i, j]
        for b in range(w):
            bias[b] = bias_of(index[b], wrapped[b])
        _projector_positions(order[a], wrapped, bias, first, per_step, last, absolute, index, part)
        for b in range(w):
            k = np.uint32(index[b] + 2)
            low[b], high[b] = table[k], table[k + np.uint32(1)]
        _other_positions(low, high, part, lines, a, correction, floats[6], floats[7])
        _nearest(y, r0, per_row, n, p)
        _nearest(x, c0, per_column, m, q)
        for b in range(w):
            absolute[b] -= slope_x * x[b] + slope_y * y[b]
        for b in range(w):
            confirmed[a, b] = UNDECIDED
            inside = (p[b] >= 0) & (q[b] >= 0) & (p[b] < n) & (q[b] < m) & (order[a, b] != UNDECIDED)
            place[a, b] = np.int32(p[b] * m + q[b]) if inside else np.int32(-1)
            if order[a, b] == UNDECIDED or p[b] < -1 or q[b] < -1:
                continue
            # The middle comes first because it nearly always decides.
            row, column, value = np.uint32(p[b] + 1), np.uint32(q[b] + 1), absolute[b]
            good = abs(other_absolute[row + np.uint32(1), column + np.uint32(1)] - value) < limit
            for t in range(9):
                if good:
                    break
                good = abs(other_absolute[row + np.uint32(t // 3), column + np.uint32(t % 3)] - value) < limit
            if good:
                confirmed[a, b] = order[a, b]
