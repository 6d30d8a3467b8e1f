"""The trigger numbers of a take: frames that contradict those already written are refused.

Readers pair frames by number alone. A frame with the number of another exposure would be paired across two different
moments, and the halves of a pair in two parts would not be paired at all.
"""

from __future__ import annotations

import numpy as np

from drivers.protocols import Frame

NUMBER_CONFLICT = "number_in_doubt"
PARTNER_IN_EARLIER_PART = "partner_in_earlier_part"
_SLOTS = 1 << 17
"""Numbers kept: twenty minutes at 100 frames a second. Memory is allocated as it is used, 3 MB in all."""


class TriggerLedger:
    """The exposure of each trigger number of a take.

    Args:
        tolerance_ns: how far the starts of the exposures of a pair may lie apart.
    """

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._numbers = np.zeros(_SLOTS, np.uint32)
        self._times = np.zeros(_SLOTS, np.int64)
        self._parts = np.zeros(_SLOTS, np.uint32)  # 0: nothing yet

    def refusal(self, frames: tuple[Frame, ...], part: int) -> str | None:
        """Return why these frames of one number must not be written into this part; None if they may."""
        for frame in frames:
            slot = frame.trigger % _SLOTS
            written_in = int(self._parts[slot])
            if not written_in or int(self._numbers[slot]) != frame.trigger:
                continue
            if abs(int(self._times[slot]) - frame.t_exposure_ns) > self._tolerance_ns:
                return NUMBER_CONFLICT
            if written_in != part:
                return PARTNER_IN_EARLIER_PART
        return None

    def wrote(self, frames: tuple[Frame, ...], part: int) -> None:
        """Record that these frames are in this part, 1, 2, ..."""
        for frame in frames:
            slot = frame.trigger % _SLOTS
            if not self._parts[slot] or int(self._numbers[slot]) != frame.trigger:
                self._numbers[slot], self._times[slot] = frame.trigger, frame.t_exposure_ns
                self._parts[slot] = part
