"""Fringe orders of neighbouring surfaces for pixels that match badly or not at all.

At a depth edge the lattice's orders reach a few pixels across. A pixel there belongs to the surface on its other side,
whose absolute phase it continues; it is matched again with that order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import serial

_PER_TURN = np.float32(0.5 / np.pi)
_TURN = np.float32(2 * np.pi)
NONE = np.int16(-32768)
_GOOD, _BAD, _NEITHER = np.uint8(1), np.uint8(2), np.uint8(0)
_ALL_GOOD = np.uint64(0x0101010101010101)


@serial
def classify_row(deviation: Any, usable: Any, good: int, bad: int, out: Any) -> None:
    """Which pixels of a row are followed, and which may take another's order, for :func:`propose_row`.

    Args:
        deviation: (W,) uint8, see :mod:`pipeline.filter.texture_agreement`; up to ``good`` a pixel is followed, from
            ``bad`` on it takes another's order.
        usable: (W,) bool, the phase is valid.
        out: (a multiple of 8 from W on,) uint8, written up to W; 0 from there on.
    """
    for j in range(deviation.shape[0]):
        open_ = (deviation[j] >= bad) & usable[j]
        out[j] = _GOOD if deviation[j] <= good else (_BAD if open_ else _NEITHER)


@serial
def propose_row(
    side: int, state: Any, order: Any, phase: Any, slope: Any, reach: int, largest: Any, ahead: Any, columns: Any,
    orders: Any,
) -> int:  # fmt: skip
    """Orders that continue the last three agreeing pixels of a row from the left or from the right, and their number.

    Args:
        side: 0 = from the left, 1 = from the right, to be called in this order.
        state: of :func:`classify_row`; order: (W,) int16; phase: (W,) float32.
        slope: expected phase step along the row, radians; reach: pixels; largest: deviation from the continued phase.
        ahead: (W,) int16, the orders from the left, :data:`NONE` where there is none; NONE before the first side.
        columns, orders: (W,), written: pixels with an order that is neither their own nor proposed from the left.
    """
    # Most pixels are inside a surface: eight of them are passed at once.
    eights = state.view(np.uint64)
    n, step = eights.shape[0], 1 if side == 0 else -1
    found, run, last = 0, 0, -1
    for t in range(n):
        eight, start = (eights[t], 8 * t) if side == 0 else (eights[n - 1 - t], 8 * (n - t) - 1)
        if eight == _ALL_GOOD:
            run, last = run + 8, start + 7 * step
            continue
        if (eight & _ALL_GOOD) == 0 and (eight == 0 or last < 0 or abs(start - last) > reach):
            run = 0
            continue
        for j in range(start, start + 8 * step, step):
            if state[j] == _GOOD:
                run += 1
                last = j if run >= 3 else last
                continue
            run = 0
            if state[j] == _BAD and last >= 0 and abs(j - last) <= reach:
                expected = phase[last] + _TURN * np.float32(order[last]) + slope * np.float32(j - last) - phase[j]
                k = np.rint(expected * _PER_TURN)
                m = np.int16(np.int32(k))
                if abs(expected - _TURN * k) < largest and m != order[j] and ahead[j] != m:
                    columns[found], orders[found] = j, m
                    found += 1
                    if side == 0:
                        ahead[j] = m
    return found
