"""The common count of triggers goes on when both cameras begin to count anew: no number is given twice.

Numbers and exposure times run the same way. A pair whose exposure is later than that of the last pair while its number
is not tells that both counts began anew; a pair that merely came late has an earlier exposure too.
"""

from __future__ import annotations

from collections.abc import Iterable

from drivers.protocols import TRIGGER_MODULUS

_HALF = TRIGGER_MODULUS // 2
_LATE = 256
"""Pairs never come later than so many numbers: what lies further back was counted anew even if the clock went back."""


class TriggerCount:
    """Remembers which numbers were given; ``counter_restarts``: how often both cameras began to count anew."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None  # number and exposure of the latest pair, or lone frame before it
        self._highest = 0
        self._paired = False
        self.counter_restarts = 0

    def move(self, number: int, t_ns: int, waiting: Iterable[int]) -> int:
        """What to add to this pair's number, and to all others from now on, so that no number comes again; mostly 0.

        Args:
            waiting: numbers of frames without a fate; those of older frames must not come again either.
        """
        if not self._began_anew(number, t_ns):
            return 0
        self.counter_restarts += 1
        behind = ((number - other) % TRIGGER_MODULUS for other in waiting)
        room = max((steps for steps in behind if steps <= _LATE), default=0)
        return (self._highest + 1 + room - number) % TRIGGER_MODULUS

    def _began_anew(self, number: int, t_ns: int) -> bool:
        if self._last is None:
            return False
        last, last_ns = self._last
        back = (last - number) % TRIGGER_MODULUS
        return back < _HALF and (t_ns > last_ns or back > _LATE)

    def gave(self, number: int, t_ns: int, *, paired: bool) -> None:
        """A pair or a lone frame left with this number.

        Lone frames count as long as there was no pair; later a single lying one must not move the count.
        """
        if self._last is None:
            self._last, self._highest = (number, t_ns), number
        if _ahead(number, self._highest):
            self._highest = number
        if (paired or not self._paired) and _ahead(number, self._last[0]):
            self._last = number, t_ns
        self._paired |= paired


def _ahead(number: int, of: int) -> bool:
    return 0 < (number - of) % TRIGGER_MODULUS < _HALF
