"""Both clocks of the host, read together to convert times between them.

Intervals and drifts (a camera's clock, a heartbeat) are measured on CLOCK_MONOTONIC, which is never set; the time of
day is computed for each frame, so that a change of that clock has no further effect than the step itself.
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
        """Read both clocks; of three readings the shortest counts."""
        best: tuple[int, Clocks] | None = None
        for _ in range(3):
            before, realtime, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
            if best is None or after - before < best[0]:
                best = after - before, cls((before + after) // 2, realtime)
        assert best is not None  # noqa: S101  # for the type checker: the loop ran
        return best[1]

    def to_realtime_ns(self, monotonic_ns: int) -> int:
        """Convert a time of CLOCK_MONOTONIC to CLOCK_REALTIME."""
        return monotonic_ns - self.monotonic_ns + self.realtime_ns
