"""Fringe orders of neighbouring surfaces for pixels that match badly or not at all.

At a depth edge the lattice's orders reach a few pixels across. A pixel there belongs to the surface on its other side,
whose absolute phase it continues; it is matched again with that order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel

_PER_TURN = np.float32(0.5 / np.pi)
_TURN = np.float32(2 * np.pi)
NONE = np.int16(-32768)


@serial
def _propose_row(
    order: Any, phase: Any, deviation: Any, usable: Any, slope: Any, good: int, bad: int, reach: int, largest: Any,
    ahead: Any, behind: Any,
) -> int:  # fmt: skip
    """Orders that continue the last three agreeing pixels of a row from the left and from the right, and their number.

    ``ahead`` and ``behind`` (W,) int16 get the proposals, NONE where there is none or it is the pixel's own.
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


@parallel
def propose(
    i: int, order: Any, phase: Any, deviation: Any, usable: Any, slope: Any, good: int, bad: int, reach: int, largest:
    Any, ahead: Any, behind: Any, count: Any,
) -> None:  # fmt: skip
    """Proposals for every pixel, from the left (``ahead``) and from the right (``behind``), (H, W) int16.

    Args:
        order: (H, W) int16; phase: (H, W) float32; usable: (H, W) bool, the phase is valid.
        deviation: (H, W) uint8, see :mod:`pipeline.filter.texture_agreement`; up to ``good`` a pixel is followed, from
            ``bad`` on it takes another's order.
        slope: expected phase step along the row, radians; reach: pixels; largest: deviation from the continued phase.
        count: (H,) int32, number of proposals.
    """
    count[i] = _propose_row(
        order[i], phase[i], deviation[i], usable[i], slope, good, bad, reach, largest, ahead[i], behind[i]
    )


class Proposals:
    """Proposed orders of one image size, in arrays that every call uses again."""

    def __init__(self, shape: tuple[int, int], slope: float) -> None:
        self._ahead, self._behind = np.empty(shape, np.int16), np.empty(shape, np.int16)
        self._count, self._slope = np.empty(shape[0], np.int32), np.float32(slope)

    def find(
        self, order: NDArray[np.int16], phase: Any, deviation: NDArray[np.uint8], usable: Any, *, good: int, bad: int,
        reach: int, largest: float,
    ) -> list[tuple[NDArray[np.int64], NDArray[np.int16]]]:  # fmt: skip
        """Flat numbers of pixels and the orders proposed for them, from the left, then from the right."""
        propose(
            len(order), order, phase, deviation, usable, self._slope, good, bad, reach, np.float32(largest),
            self._ahead, self._behind, self._count,
        )  # fmt: skip
        if not self._count.any():
            return []
        rows = np.flatnonzero(self._count)
        width = order.shape[1]
        found = []
        for plane in (self._ahead, self._behind):
            some = plane[rows]
            a, b = np.nonzero(some != NONE)
            found.append((rows[a] * width + b, some[a, b]))
        return [(pixels, orders) for pixels, orders in found if len(pixels)]
