"""From the lattice's decisions to an order for every pixel: left/right agreement first, then phase continuity."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.candidates import column_at, parameter, ratio, shift_of
from pipeline.kernels import parallel, prange

NONE = -32768
_TWO_PI = 2 * pi


@parallel
def cross_check(
    order: Any, rows: Any, columns: Any, along: Any, across: Any, other_u: Any, other_v: Any,
    phase: Any, phase_eq: Any, other_order: Any, other_rows: Any, other_columns: Any, other_phase: Any,
    table: Any, correction: Any, slope_x: float, slope_y: float, limit: float,
) -> Any:  # fmt: skip
    """Orders (h, w) int16 kept where the other camera, asked from its own side, gives the same absolute phase there.

    ``slope_x`` and ``slope_y`` are the other picture's expected phase steps per pixel.
    """
    h, w = order.shape
    kept = np.full((h, w), np.int16(NONE))
    r0, c0 = other_rows[0], other_columns[0]
    dr, dc = other_rows[1] - other_rows[0], other_columns[1] - other_columns[0]
    for a in prange(h):
        for b in range(w):
            if order[a, b] == NONE:
                continue
            i, j = rows[a], columns[b]
            absolute = phase[i, j] + _TWO_PI * order[a, b]
            bias = phase_eq[i, j] - phase[i, j]
            bias -= _TWO_PI * np.rint(bias / _TWO_PI)
            u = column_at(table, absolute + bias)
            if u != u:
                u = column_at(table, absolute)
            s = parameter(along[a, b], u - shift_of(correction, u, ratio(across[a, b], 0.5)))
            x, y = ratio(other_u[a, b], s), ratio(other_v[a, b], s)
            if not (x == x and y == y):
                continue
            p, q = int(np.rint((y - r0) / dr)), int(np.rint((x - c0) / dc))
            good = False
            for dp in range(-1, 2):
                for dq in range(-1, 2):
                    pp, qq = p + dp, q + dq
                    if pp < 0 or qq < 0 or pp >= other_order.shape[0] or qq >= other_order.shape[1]:
                        continue
                    if other_order[pp, qq] == NONE:
                        continue
                    oi, oj = other_rows[pp], other_columns[qq]
                    seen = other_phase[oi, oj] + _TWO_PI * other_order[pp, qq]
                    if abs(seen - absolute - slope_x * (oj - x) - slope_y * (oi - y)) < limit:
                        good = True
            if good:
                kept[a, b] = order[a, b]
    return kept


@parallel
def spread(order: Any, rows: Any, columns: Any, phase: Any, valid: Any, slope_x: float, slope_y: float) -> Any:
    """Order of every pixel (H, W) int16 from the lattice pixels around it.

    Among the (up to four) decided neighbours the one whose phase continues to this pixel with the least deviation is
    followed; a pixel without any stays unknown.
    """
    height, width = phase.shape
    h, w = order.shape
    out = np.full((height, width), np.int16(NONE))
    dr, dc = rows[1] - rows[0], columns[1] - columns[0]
    for i in prange(height):
        a0 = (i - rows[0]) // dr
        for j in range(width):
            if not valid[i, j]:
                continue
            b0 = (j - columns[0]) // dc
            least = 2.2
            for a in range(a0, a0 + 2):
                if a < 0 or a >= h:
                    continue
                for b in range(b0, b0 + 2):
                    if b < 0 or b >= w or order[a, b] == NONE:
                        continue
                    di, dj = i - rows[a], j - columns[b]
                    expected = phase[rows[a], columns[b]] + _TWO_PI * order[a, b] + slope_x * dj + slope_y * di
                    m = np.rint((expected - phase[i, j]) / _TWO_PI)
                    away = abs(phase[i, j] + _TWO_PI * m - expected) + 0.15 * (abs(di) + abs(dj))
                    if away < least:
                        least = away
                        out[i, j] = np.int16(m)
    return out
