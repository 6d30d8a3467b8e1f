"""Exposure times of frames on CLOCK_REALTIME, and their trigger numbers."""

from __future__ import annotations

from drivers.host_clocks import Clocks
from drivers.protocols import TRIGGER_MODULUS

_PLAUSIBLE_NS = 10_000_000_000
_FUTURE_NS = 50_000_000
_STARTS_AT_ZERO = 32
"""A first number below this means a count that began at 0 and lost its first frames."""


def realtime_of(timestamp_ns: int, clocks: Clocks) -> int | None:
    """Convert a driver's time stamp to CLOCK_REALTIME; None when it matches no clock.

    Drivers stamp by CLOCK_MONOTONIC. Some can be configured to CLOCK_REALTIME and still report monotonic, some report
    no clock, so that the value decides: a frame just dequeued is at most seconds old.
    """
    for now_ns in (clocks.monotonic_ns, clocks.realtime_ns):
        if -_FUTURE_NS <= now_ns - timestamp_ns <= _PLAUSIBLE_NS:
            return timestamp_ns - now_ns + clocks.realtime_ns
    return None


class Sequence:
    """The driver's frame numbers as trigger numbers, gaps counted.

    The kernel counts every frame of a stream from 0, also those for which it had no buffer. Drivers that start at
    another number are anchored at the first frame.
    """

    def __init__(self) -> None:
        self._anchor: int | None = None
        self._last: int | None = None

    def feed(self, number: int) -> tuple[int, int]:
        """Return (trigger, frames missing since the last one); -1 missing: the count decreased."""
        if self._anchor is None or self._last is None:
            self._anchor = 0 if number < _STARTS_AT_ZERO else number
            missing = number - self._anchor
        else:
            step = (number - self._last) % TRIGGER_MODULUS
            missing = step - 1 if 0 < step < TRIGGER_MODULUS // 2 else -1
        self._last = number
        return (number - self._anchor) % TRIGGER_MODULUS, missing
