"""The common trigger count continues after a restart of both cameras' counters: no number is assigned twice.

Numbers and exposure times run the same way. A pair whose exposure is later than that of the last pair while its number
is not shows that both counters restarted; a pair that merely came late has an earlier exposure too.
"""

from __future__ import annotations

from collections.abc import Iterable

from drivers.protocols import TRIGGER_MODULUS

_HALF = TRIGGER_MODULUS // 2
_LATE = 256
"""Pairs are never late by more numbers; what lies further back is a restart even if the clock was set back."""


class TriggerCount:
    """Remembers which numbers were assigned; ``counter_restarts``: how often both cameras' counters restarted."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None  # number and exposure of the latest pair, or unpaired frame before it
        self._highest = 0
        self._paired = False
        self.counter_restarts = 0

    def move(self, number: int, t_ns: int, waiting: Iterable[int]) -> int:
        """Return what to add to this pair's number, and to all later ones, so that no number repeats; mostly 0.

        Args:
            waiting: numbers of frames without an outcome; those of older frames must not repeat either.
        """
        if not self._restarted(number, t_ns):
            return 0
        self.counter_restarts += 1
        behind = ((number - other) % TRIGGER_MODULUS for other in waiting)
        margin = max((steps for steps in behind if steps <= _LATE), default=0)
        return (self._highest + 1 + margin - number) % TRIGGER_MODULUS

    def _restarted(self, number: int, t_ns: int) -> bool:
        if self._last is None:
            return False
        last, last_ns = self._last
        back = (last - number) % TRIGGER_MODULUS
        return back < _HALF and (t_ns > last_ns or back > _LATE)

    def assigned(self, number: int, t_ns: int, *, paired: bool) -> None:
        """Note that a pair or an unpaired frame left with this number.

        Unpaired frames count as long as there was no pair; later a single wrong one must not move the count.
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
