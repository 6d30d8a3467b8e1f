"""Orders of a lattice from confident decisions on every second pixel of it, along continuous phase.

Most of an image is smooth surface, where neighbouring searches give the same order. The search is done on a quarter of
the lattice; a pixel between two confident ones whose phase leads to the same order needs no search of its own. What
stays open (edges, unconfident decisions, noise) is searched on the whole lattice, with the certain orders given.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, linked
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import whole_turns
from pipeline.fringe_order.semi_global_aggregation import NONE

_TURN, _ZERO = np.float32(2 * np.pi), np.float32(0)
_MAX_STEP_CHANGE = np.float32(1.0)
"""Largest change of the phase's step from one pixel to the next along a continuous surface, radians."""


@inline
def _unwrap_step(
    total: Any, last: Any, worst: Any, first: bool, phase: Any, next_phase: Any, slope: Any
) -> tuple[Any, Any, Any]:
    """Unwrap one more pixel: phase gained so far, last step minus the slope, largest change of the step."""
    d = next_phase - phase - slope
    d -= _TURN * whole_turns(d)
    change = abs(d - last)
    return total + d + slope, d, worst if first or change < worst else change


@inline
def _common_order(before: Any, after: Any, from_before: Any, from_after: Any) -> Any:
    """The order that the phases of both neighbours lead to, NONE if they lead to different ones."""
    one, other = before + np.int32(whole_turns(from_before)), after + np.int32(whole_turns(from_after))
    return np.int16(one) if one == other else np.int16(NONE)


@linked
def _between_columns(phase: Any, valid: Any, left: int, step: int, slope: Any, row: Any) -> None:
    """Fill the odd pixels of a lattice row (w,) from its even ones; ``phase``, ``valid``: the image's row."""
    for b in range(1, row.shape[0] - 1, 2):
        row[b] = NONE
        if row[b - 1] == NONE or row[b + 1] == NONE:
            continue
        m = np.uint32(left + step * (b - 1))
        total, last, worst, all_valid, half = _ZERO, _ZERO, _ZERO, True, _ZERO
        for s in range(2 * step):
            j = m + np.uint32(s)
            total, last, worst = _unwrap_step(total, last, worst, s == 0, phase[j], phase[j + np.uint32(1)], slope)
            all_valid &= valid[j + np.uint32(1)]
            half = total if s == step - 1 else half
        if all_valid and worst < _MAX_STEP_CHANGE:
            middle, end = m + np.uint32(step), m + np.uint32(2 * step)
            row[b] = _common_order(row[b - 1], row[b + 1], phase[m] + half - phase[middle],
                             phase[end] + half - total - phase[middle])  # fmt: skip
    if row.shape[0] % 2 == 0:
        row[row.shape[0] - 1] = NONE


@linked
def _between_rows(
    phase: Any, valid: Any, i: int, down: int, left: int, step: int, slope: Any, above: Any, below: Any, row: Any
) -> None:
    """Fill the even pixels of an odd lattice row from those above and below; i: image row of the one above."""
    for b in range(0, row.shape[0], 2):
        row[b] = NONE
        if above[b] == NONE or below[b] == NONE:
            continue
        j = np.uint32(left + step * b)
        total, last, worst, all_valid, half = _ZERO, _ZERO, _ZERO, True, _ZERO
        for s in range(2 * down):
            total, last, worst = _unwrap_step(total, last, worst, s == 0, phase[i + s, j], phase[i + s + 1, j], slope)
            all_valid &= valid[i + s + 1, j]
            half = total if s == down - 1 else half
        if all_valid and worst < _MAX_STEP_CHANGE:
            middle = phase[i + down, j]
            row[b] = _common_order(above[b], below[b], phase[i, j] + half - middle,
                             phase[i + 2 * down, j] + half - total - middle)  # fmt: skip


def interpolate_orders(
    coarse: Any, confident: Any, phase: Any, valid: Any, top: int, down: int, left: int, step: int, slope_x: Any,
    slope_y: Any, certain: Any,
) -> None:  # fmt: skip
    """Fill ``certain`` (h, w) int16 with the orders that are certain, NONE elsewhere.

    Args:
        coarse, confident: (ceil(h / 2), ceil(w / 2)) orders of every second lattice pixel, and 1 where confident.
        phase, valid: (H, W) of the image; lattice pixel (a, b) is row ``top + down a``, column ``left + step b``.
        slope_x, slope_y: expected phase steps per pixel, radians.
    """
    h = len(certain)
    _even_row((h + 1) // 2, coarse, confident, phase, valid, top, down, left, step, slope_x, certain)
    _odd_row(h // 2, phase, valid, top, down, left, step, slope_x, slope_y, certain)


@parallel
def _even_row(
    k: int, coarse: Any, confident: Any, phase: Any, valid: Any, top: int, down: int, left: int, step: int,
    slope_x: Any, certain: Any,
) -> None:  # fmt: skip
    """Lattice row 2 k: confident orders, and those between them."""
    a = 2 * k
    for b in range((certain.shape[1] + 1) // 2):
        certain[a, 2 * b] = coarse[k, b] if confident[k, b] != 0 else NONE
    _between_columns(phase[top + down * a], valid[top + down * a], left, step, slope_x, certain[a])


@parallel
def _odd_row(
    k: int, phase: Any, valid: Any, top: int, down: int, left: int, step: int, slope_x: Any, slope_y: Any, certain: Any
) -> None:
    """Lattice row 2 k + 1, from the rows above and below."""
    a = 2 * k + 1
    row = certain[a]
    if a + 1 < certain.shape[0]:
        _between_rows(phase, valid, top + down * (a - 1), down, left, step, slope_y, certain[a - 1],
                      certain[a + 1], row)  # fmt: skip
        _between_columns(phase[top + down * a], valid[top + down * a], left, step, slope_x, row)
    else:
        row[:] = NONE
