"""SIGHUP: rig.yaml is read again, in a thread of its own, so that the main loop goes on; or a terminal was closed."""

from __future__ import annotations

import logging
import os
import select
import threading
from collections.abc import Callable, Iterable

log = logging.getLogger("fringed")


class Reloads:
    """Turns requests of a signal handler into reloads, one at a time; requests that come meanwhile become one more.

    Args:
        reload: does it and logs its outcome, once; may take seconds. ready: whether it is possible yet.
    """

    def __init__(self, reload: Callable[[], object], *, ready: Callable[[], bool]) -> None:
        self._reload, self._ready = reload, ready
        self._requested = False
        self._thread: threading.Thread | None = None

    def request(self) -> None:
        """Request a reload; takes no lock, so that a signal handler may call it."""
        self._requested = True

    def tick(self) -> None:
        """Called by the main loop: begin what was requested."""
        if not self._requested or not self._ready() or (self._thread is not None and self._thread.is_alive()):
            return
        self._requested = False
        self._thread = threading.Thread(target=self._run, name="reload", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._reload()
        except Exception as error:  # a bad file must not end anything: what ran before goes on
            log.debug("the reload failed: %s", error)


def terminals(descriptors: Iterable[int] = (0, 1, 2)) -> tuple[int, ...]:
    """Those descriptors that are terminals."""
    return tuple(number for number in descriptors if os.isatty(number))


def hung_up(descriptors: Iterable[int]) -> bool:
    """Whether one of these terminals is gone: then SIGHUP reports its end and requests no reload."""
    poll = select.poll()
    for number in descriptors:
        poll.register(number, 0)
    return any(events & (select.POLLHUP | select.POLLERR) for _, events in poll.poll(0))
