"""Milliseconds by stage from a clock that the caller hands in; the pipeline has none of its own."""

from __future__ import annotations

from collections.abc import Callable


class Stopwatch:
    """Adds up laps by name; does nothing without a clock."""

    def __init__(self, clock: Callable[[], int] | None) -> None:
        self._clock = clock
        self._last = clock() if clock else 0
        self.ms: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Book the time since the last lap under this name."""
        if self._clock is None:
            return
        now = self._clock()
        self.ms[name] = self.ms.get(name, 0.0) + (now - self._last) / 1e6
        self._last = now
