"""A request to stop that a signal handler may set.

``threading.Event`` takes a lock that the interrupted thread may hold at that very moment, and then both wait for ever.
"""

from __future__ import annotations

import os
import select
import weakref


class StopEvent:
    """Set once, from any thread or signal handler; never cleared."""

    def __init__(self) -> None:
        self._set = False
        self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        weakref.finalize(self, os.close, self._fd)

    def set(self) -> None:
        """Wake all waiting threads, now and later."""
        if not self._set:
            self._set = True
            os.eventfd_write(self._fd, 1)

    def is_set(self) -> bool:
        """Whether it was set."""
        return self._set

    def wait(self, timeout_s: float) -> bool:
        """Wait until it is set, or for ``timeout_s``; whether it is set."""
        if not self._set:
            poll = select.poll()
            # The counter is never read, so the descriptor stays ready for every thread.
            poll.register(self._fd, select.POLLIN)
            poll.poll(max(0, round(1000 * timeout_s)))
        return self._set
