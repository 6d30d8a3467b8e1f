"""Both clocks of the host read together, so that a time of one can be told on the other.

What is followed over time (a camera's clock, a heartbeat) is followed on CLOCK_MONOTONIC, which nobody sets; the time
of the day is worked out for each frame anew, so that a clock that was set costs nothing but the step itself.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


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

    def day(self, monotonic_ns: int) -> int:
        """A time of CLOCK_MONOTONIC on CLOCK_REALTIME."""
        return monotonic_ns - self.monotonic_ns + self.realtime_ns
