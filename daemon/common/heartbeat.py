"""A heartbeat with a deadline: a thread that hangs misses it."""

from __future__ import annotations

import time
from collections.abc import Callable


class Heartbeat:
    """Set by one thread at every turn of its loop, read by another; no lock, a number is exchanged.

    Args:
        now_ns: monotonic time.
    """

    def __init__(self, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._now_ns = now_ns
        self._due_ns: int | None = None

    def expect(self, within_s: float) -> None:
        """Set the deadline of the next turn, seconds from now."""
        self._due_ns = self._now_ns() + round(1e9 * within_s)

    def rest(self) -> None:
        """Set no deadline any more: the thread ends."""
        self._due_ns = None

    @property
    def due_ns(self) -> int | None:
        """The deadline of the present turn, monotonic; None without one."""
        return self._due_ns

    def overdue_s(self) -> float:
        """Seconds since the deadline was missed; 0 while it is kept."""
        due_ns = self._due_ns
        return 0.0 if due_ns is None else max(0.0, (self._now_ns() - due_ns) / 1e9)
