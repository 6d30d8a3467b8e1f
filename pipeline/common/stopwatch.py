"""Milliseconds by stage, measured with the caller's clock."""

from __future__ import annotations

from collections.abc import Callable


class Stopwatch:
    """Sum of laps by name; does nothing without a clock."""

    def __init__(self, clock: Callable[[], int] | None) -> None:
        self._clock = clock
        self._last = clock() if clock else 0
        self.ms: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Add the time since the last lap to this name."""
        if self._clock is None:
            return
        now = self._clock()
        self.ms[name] = self.ms.get(name, 0.0) + (now - self._last) / 1e6
        self._last = now
