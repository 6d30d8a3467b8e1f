"""A thread's word that it will be back in time: what a frozen thread cannot keep."""

from __future__ import annotations

import time
from collections.abc import Callable


class Heartbeat:
    """Set by one thread at every turn of its loop, looked at by another; no lock, a number is exchanged.

    Args:
        now_ns: monotonic time.
    """

    def __init__(self, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._now_ns = now_ns
        self._due_ns: int | None = None

    def expect(self, within_s: float) -> None:
        """Promise the next sign within so many seconds."""
        self._due_ns = self._now_ns() + round(1e9 * within_s)

    def rest(self) -> None:
        """Promise nothing more: the thread comes to its end."""
        self._due_ns = None

    def overdue_s(self) -> float:
        """For how long the promise has been broken, seconds; 0 while it is kept."""
        due_ns = self._due_ns
        return 0.0 if due_ns is None else max(0.0, (self._now_ns() - due_ns) / 1e9)
