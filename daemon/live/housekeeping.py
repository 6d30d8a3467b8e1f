"""What the main loop does beside the measurement: periodic actions, names of threads, processor share, status."""

from __future__ import annotations

import logging
from collections.abc import Callable

from daemon.common.processor_share import ProcessorShare
from daemon.common.threads import ThreadNamer
from drivers.protocols import Clock

log = logging.getLogger("fringed")

_STATUS_NS = 1_000_000_000


class Housekeeping:
    """Periodic work of one thread, which calls :meth:`tick` several times a second.

    Args:
        publish_status: called once a second, and with every call of :meth:`publish_status`; None: not at all.
    """

    def __init__(self, share: ProcessorShare, clock: Clock, publish_status: Callable[[], object] | None) -> None:
        self._share, self._clock, self._publish = share, clock, publish_status
        #: Called with every tick.
        self.actions: list[Callable[[], None]] = []
        self._namer = ThreadNamer("fringed")
        self._short_of_processors = False
        self._status_due_ns = 0

    def tick(self) -> None:
        """Run the actions, and once a second name new threads and publish the status."""
        self._share.tick()
        for action in self.actions:
            guarded("a periodic action", action)
        now_ns = self._clock.monotonic_ns()
        if now_ns >= self._status_due_ns:
            self._status_due_ns = now_ns + _STATUS_NS
            self._namer.update()
            self._note_processors()
            self.publish_status()

    def publish_status(self) -> None:
        """Publish the status now; a failure is logged."""
        if self._publish is not None:
            guarded("publishing the status", self._publish)

    def _note_processors(self) -> None:
        """Log when other programs begin, or end, to take more than half of the processor time that is needed."""
        warnings = self._share.warnings()
        if warnings and not self._short_of_processors:
            log.warning("%s", warnings[0])
        elif self._short_of_processors and not warnings:
            log.info("the daemon gets the processor time again that it needs")
        self._short_of_processors = bool(warnings)


def guarded(what: str, action: Callable[[], object]) -> None:
    """Run an action; its failure is logged and must not keep the rest from being done."""
    try:
        action()
    except Exception:
        log.exception("%s failed", what)
