"""The machine's clocks behind the Clock protocol."""

from __future__ import annotations

import time


class SystemClock:
    """CLOCK_REALTIME and CLOCK_MONOTONIC."""

    def realtime_ns(self) -> int:
        """CLOCK_REALTIME, nanoseconds."""
        return time.time_ns()

    def monotonic_ns(self) -> int:
        """CLOCK_MONOTONIC, nanoseconds."""
        return time.monotonic_ns()
