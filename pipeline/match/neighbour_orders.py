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


@serial
def propose_row(
    order: Any, phase: Any, deviation: Any, usable: Any, slope: Any, good: int, bad: int, reach: int, largest: Any,
    ahead: Any, behind: Any,
) -> int:  # fmt: skip
    """Orders that continue the last three agreeing pixels of a row from the left and from the right, and their number.

    Args:
        order: (W,) int16; phase: (W,) float32; usable: (W,) bool, the phase is valid.
        deviation: (W,) uint8, see :mod:`pipeline.filter.texture_agreement`; up to ``good`` a pixel is followed, from
            ``bad`` on it takes another's order.
        slope: expected phase step along the row, radians; reach: pixels; largest: deviation from the continued phase.
        ahead, behind: (W,) int16, the proposals from the left and from the right, :data:`NONE` where there is none or
            it is the pixel's own.
    """
    width = order.shape[0]
    found = 0
    for side in range(2):
        run, last = 0, -1
        step = 1 if side == 0 else -1
        out = ahead if side == 0 else behind
        j = 0 if side == 0 else width - 1
        for _ in range(width):
            out[j] = NONE
            if deviation[j] <= good:
                run += 1
                last = j if run >= 3 else last
            else:
                run = 0
                if deviation[j] >= bad and usable[j] and last >= 0 and abs(j - last) <= reach:
                    expected = phase[last] + _TURN * np.float32(order[last]) + slope * np.float32(j - last) - phase[j]
                    k = np.rint(expected * _PER_TURN)
                    m = np.int16(np.int32(k))
                    if abs(expected - _TURN * k) < largest and m != order[j] and (side == 0 or ahead[j] != m):
                        out[j] = m
                        found += 1
            j += step
    return found
