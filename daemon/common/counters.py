"""Counters for any thread: events by name, rates over the last seconds, percentiles."""

from __future__ import annotations

import threading
from collections import Counter, deque

import numpy as np


class Counters:
    """Events by name."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()

    def add(self, name: str, count: int = 1) -> None:
        """Count an event."""
        with self._lock:
            self._counts[name] += count

    def snapshot(self) -> dict[str, int]:
        """All counts so far, by name."""
        with self._lock:
            return dict(sorted(self._counts.items()))

    def __getitem__(self, name: str) -> int:
        with self._lock:
            return self._counts[name]


class Rate:
    """Events per second over a sliding window."""

    def __init__(self, window_s: float = 3.0) -> None:
        self._window_ns = round(window_s * 1e9)
        self._lock = threading.Lock()
        self._times: deque[int] = deque(maxlen=4096)
        self._first_ns: int | None = None

    def note(self, now_ns: int) -> None:
        """Note an event; the time is monotonic."""
        with self._lock:
            self._first_ns = now_ns if self._first_ns is None else self._first_ns
            self._times.append(now_ns)

    def per_second(self, now_ns: int) -> float:
        """The rate over the window, or over the time since the first event while that is shorter."""
        with self._lock:
            if self._first_ns is None:
                return 0.0
            recent = sum(1 for t_ns in self._times if t_ns > now_ns - self._window_ns)
            span_ns = min(self._window_ns, now_ns - self._first_ns)
            # While the window is not full yet, the first event only marks its beginning.
            recent -= span_ns < self._window_ns
            return recent / (span_ns / 1e9) if span_ns > 200_000_000 else 0.0


class Percentiles:
    """The last values and their distribution.

    Args:
        size: values that are kept; half an hour at 10 a second, ten minutes at 30.
    """

    def __init__(self, size: int = 18_000) -> None:
        self._lock = threading.Lock()
        self._values = np.zeros(size)
        self._count = 0

    def note(self, value: float) -> None:
        """Add a value."""
        with self._lock:
            self._values[self._count % len(self._values)] = value
            self._count += 1

    def summary(self) -> dict[str, float]:
        """p50, p95, p99, p999 (99.9 %), max and last; empty before the first value."""
        with self._lock:
            size = min(self._count, len(self._values))
            if not size:
                return {}
            values, last = self._values[:size].copy(), self._values[(self._count - 1) % len(self._values)]
        indices = {name: min(size - 1, int(share * size)) for name, share in _SHARES}
        values.partition([*indices.values(), size - 1])
        at = {name: values[index] for name, index in indices.items()} | {"max": values[-1], "last": last}
        return {name: round(float(value), 3) for name, value in at.items()}


_SHARES = (("p50", 0.50), ("p95", 0.95), ("p99", 0.99), ("p999", 0.999))
