"""Clocks: the machine's, and one that is advanced by its user."""

from __future__ import annotations

import time


class SystemClock:
    """The machine's clocks."""

    def realtime_ns(self) -> int:
        """CLOCK_REALTIME, nanoseconds."""
        return time.time_ns()

    def monotonic_ns(self) -> int:
        """CLOCK_MONOTONIC, nanoseconds."""
        return time.monotonic_ns()


class SteppedClock:
    """A clock that moves only by :meth:`advance`; for tests and for lock-step runs."""

    def __init__(self, start_ns: int = 1_700_000_000_000_000_000) -> None:
        self._now_ns = start_ns

    def advance(self, by_ns: int) -> None:
        """Advance the clock."""
        self._now_ns += by_ns

    def realtime_ns(self) -> int:
        """The current time, nanoseconds."""
        return self._now_ns

    def monotonic_ns(self) -> int:
        """The same time, nanoseconds."""
        return self._now_ns
