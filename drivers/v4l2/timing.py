"""When the exposure of a frame began, on CLOCK_REALTIME, and which trigger it belongs to."""

from __future__ import annotations

import time
from dataclasses import dataclass

from drivers.protocols import TRIGGER_MODULUS

_PLAUSIBLE_NS = 10_000_000_000
_FUTURE_NS = 50_000_000
_STARTS_AT_ZERO = 32
"""A first number below this is taken for a count that began at 0, its first frames lost."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """Both clocks of the host at one moment, nanoseconds."""

    monotonic_ns: int
    realtime_ns: int

    @classmethod
    def now(cls) -> Clocks:
        """Read both; of three readings the one that took the least time counts."""
        best: tuple[int, Clocks] | None = None
        for _ in range(3):
            before, realtime, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
            if best is None or after - before < best[0]:
                best = after - before, cls((before + after) // 2, realtime)
        assert best is not None  # noqa: S101  # for the type checker: the loop ran
        return best[1]

    def realtime_of(self, timestamp_ns: int) -> int | None:
        """A driver's time stamp on CLOCK_REALTIME; None when it fits no clock.

        Drivers stamp by CLOCK_MONOTONIC. Some can be configured to CLOCK_REALTIME and say monotonic all the same, some
        say nothing, so that the value decides: a frame just fetched is at most seconds old.
        """
        for now_ns in (self.monotonic_ns, self.realtime_ns):
            if -_FUTURE_NS <= now_ns - timestamp_ns <= _PLAUSIBLE_NS:
                return timestamp_ns - now_ns + self.realtime_ns
        return None


class Sequence:
    """The driver's frame numbers as trigger numbers, gaps counted.

    The kernel counts every frame of a stream from 0, also those for which it had no buffer. Drivers that go on from
    elsewhere are anchored at the first frame that came.
    """

    def __init__(self) -> None:
        self._anchor: int | None = None
        self._last: int | None = None

    def feed(self, number: int) -> tuple[int, int]:
        """Returns (trigger, frames missing since the last one); -1 missing means that the count went back."""
        if self._anchor is None or self._last is None:
            self._anchor = 0 if number < _STARTS_AT_ZERO else number
            missing = number - self._anchor
        else:
            step = (number - self._last) % TRIGGER_MODULUS
            missing = step - 1 if 0 < step < TRIGGER_MODULUS // 2 else -1
        self._last = number
        return (number - self._anchor) % TRIGGER_MODULUS, missing
