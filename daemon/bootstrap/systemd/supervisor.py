"""Notifies the service manager from the main loop: ready with the first cloud, a status line, the watchdog."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from daemon.bootstrap.systemd.notifier import Notifier
from daemon.bootstrap.systemd.status_line import describe
from daemon.bootstrap.systemd.watchdog import Watchdog
from daemon.live.service import Service

log = logging.getLogger("fringed")

EXTEND_S = 60.0
"""While starting, the manager gives up when no message comes for so long."""
_EXTEND_EVERY_S = 5.0
_FEED_EVERY_S = 2.0


class Supervisor:
    """Notifies the manager of one daemon; without effect where there is no manager.

    Args:
        notifier: to the manager; now_s: monotonic seconds.
    """

    def __init__(self, notifier: Notifier, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._notifier, self._now_s = notifier, now_s
        self._service: Service | None = None
        self._watchdog: Watchdog | None = None
        self._ready = self._reloading = False
        self._line, self._problem = "starting", ""
        self._extend_due_s = self._feed_due_s = 0.0
        self._feed_every_s = min(_FEED_EVERY_S, (notifier.watchdog_s or 60.0) / 4)

    @property
    def ready(self) -> bool:
        """Whether the manager was notified of the first cloud."""
        return self._ready

    def preparing(self, what: str) -> None:
        """Report what is being prepared, before there is a service."""
        self._line = f"starting: {what}"
        self._notifier.status(self._line)
        self._extend()

    def watch(self, service: Service) -> None:
        """Notify the manager of this service from now on."""
        self._service, self._watchdog = service, Watchdog(service)
        if self._notifier.active:
            service.on_tick.append(self.tick)

    def tick(self) -> None:
        """Called by the service's main loop ten times a second."""
        service, watchdog = self._service, self._watchdog
        if service is None or watchdog is None or service.stopping:
            return
        self._note(watchdog.problem())
        if self._problem:
            return
        if not self._ready and service.worker.clouds:
            self._line = describe(service.status().as_dict())
            self._ready = self._notifier.ready(self._line)
        if not self._ready:
            self._extend()
        self._feed()

    def note_status(self, status: dict[str, Any]) -> None:
        """Called with the status once a second."""
        self._line = f"not alive: {self._problem}" if self._problem else describe(status)
        self._notifier.status(self._line)

    def reload(self, action: Callable[[], Any]) -> Any:
        """Run a reload between the two messages that announce it."""
        if self._ready:
            self._notifier.reloading()
        try:
            return action()
        finally:
            if self._ready:
                self._notifier.ready(self._line)

    def stopping(self) -> None:
        """Report that the daemon stops; takes no lock, so that a signal handler may call it."""
        self._notifier.stopping()

    def close(self) -> None:
        """Send nothing more."""
        self._notifier.close()

    def _note(self, problem: str) -> None:
        if problem and problem != self._problem:
            log.critical("the watchdog is not fed any more: %s", problem)
        elif self._problem and not problem:
            log.warning("the watchdog is fed again: before, %s", self._problem)
        self._problem = problem

    def _extend(self) -> None:
        if self._now_s() >= self._extend_due_s and self._notifier.extend(EXTEND_S):
            self._extend_due_s = self._now_s() + _EXTEND_EVERY_S

    def _feed(self) -> None:
        if self._notifier.watchdog_s is not None and self._now_s() >= self._feed_due_s and self._notifier.alive():
            self._feed_due_s = self._now_s() + self._feed_every_s
