"""No two exposures under one number: what a take holds already is remembered, and what contradicts it is refused.

Readers bring frames together by number alone. A frame under a number that another exposure has would make a pair of two
different moments; so would halves of a pair in two parts go unnoticed.
"""

from __future__ import annotations

import numpy as np

from drivers.protocols import Frame

IN_DOUBT = "number_in_doubt"
OTHER_PART = "partner_in_earlier_part"
_SLOTS = 1 << 17
"""Numbers remembered: twenty minutes at 100 frames a second. Memory is taken as it is used, 3 MB in all."""


class Numbers:
    """Which exposure each number of a take has.

    Args:
        tolerance_ns: how far the starts of the exposures of a pair may lie apart.
    """

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._numbers = np.zeros(_SLOTS, np.uint32)
        self._times = np.zeros(_SLOTS, np.int64)
        self._parts = np.zeros(_SLOTS, np.uint32)  # 0: nothing yet

    def refusal(self, frames: tuple[Frame, ...], part: int) -> str | None:
        """Why these frames of one number must not be written into this part; None if they may."""
        for frame in frames:
            slot = frame.trigger % _SLOTS
            held = int(self._parts[slot])
            if not held or int(self._numbers[slot]) != frame.trigger:
                continue
            if abs(int(self._times[slot]) - frame.t_exposure_ns) > self._tolerance_ns:
                return IN_DOUBT
            if held != part:
                return OTHER_PART
        return None

    def wrote(self, frames: tuple[Frame, ...], part: int) -> None:
        """These frames are in this part, 1, 2, ..."""
        for frame in frames:
            slot = frame.trigger % _SLOTS
            if not self._parts[slot] or int(self._numbers[slot]) != frame.trigger:
                self._numbers[slot], self._times[slot] = frame.trigger, frame.t_exposure_ns
                self._parts[slot] = part
