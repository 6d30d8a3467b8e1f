"""Periodic queries that may take long or hang (a lost disk, another program), each in a thread of its own."""

from __future__ import annotations

import logging
import os
import resource
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

from daemon.common.files import existing_parent
from drivers.protocols import Clock

log = logging.getLogger("fringed.health")

T = TypeVar("T")
_MOST_AGE = 6  # periods after which a value has expired


class Probe(Generic[T]):
    """Runs a query every ``period_s`` in a thread of its own; old values expire."""

    def __init__(self, name: str, query: Callable[[], T], *, period_s: float, clock: Clock) -> None:
        self._query, self._period_s, self._clock = query, period_s, clock
        self._newest: tuple[int, T] | None = None
        self._failed = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"health-{name}", daemon=True)
        self._thread.start()

    def value(self) -> T | None:
        """Return the newest value, None where there is none yet or it has expired."""
        newest = self._newest
        if newest is None or self._clock.monotonic_ns() - newest[0] > _MOST_AGE * self._period_s * 1e9:
            return None
        return newest[1]

    def close(self) -> None:
        """End the queries; a hanging one is left behind."""
        self._stop.set()
        self._thread.join(1.0)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                value = self._query()
                self._newest, self._failed = (self._clock.monotonic_ns(), value), ""
            except Exception as error:
                if str(error) != self._failed:
                    log.warning("%s failed: %s", self._thread.name, error)
                self._failed = str(error)
            self._stop.wait(self._period_s)


def free_gb(directory: Path) -> float:
    """Return the free space for ordinary users on the disk of a directory, or of its nearest existing parent."""
    stats = os.statvfs(existing_parent(directory))
    return stats.f_bavail * stats.f_frsize / 1e9


def memory_mb() -> float:
    """Return the resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6
