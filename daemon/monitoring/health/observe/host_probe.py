"""Questions that may take long or hang (a disk that is gone, another program), asked again and again aside."""

from __future__ import annotations

import logging
import os
import resource
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

from daemon.common.places import existing
from drivers.protocols import Clock

log = logging.getLogger("fringed.health")

T = TypeVar("T")
_OLD = 6  # periods after which an answer is worth nothing


class Probe(Generic[T]):
    """Asks a question every ``period_s`` in a thread of its own; an answer that is old is no answer."""

    def __init__(self, name: str, question: Callable[[], T], *, period_s: float, clock: Clock) -> None:
        self._question, self._period_s, self._clock = question, period_s, clock
        self._answer: tuple[int, T] | None = None
        self._failed = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"health-{name}", daemon=True)
        self._thread.start()

    def answer(self) -> T | None:
        """The newest answer, None where there is none yet or it is old."""
        known = self._answer
        if known is None or self._clock.monotonic_ns() - known[0] > _OLD * self._period_s * 1e9:
            return None
        return known[1]

    def close(self) -> None:
        """Ask no more; a question that hangs is not waited for."""
        self._stop.set()
        self._thread.join(1.0)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                answer = self._question()
                self._answer, self._failed = (self._clock.monotonic_ns(), answer), ""
            except Exception as error:
                if str(error) != self._failed:
                    log.warning("%s cannot tell: %s", self._thread.name, error)
                self._failed = str(error)
            self._stop.wait(self._period_s)


def free_gb(directory: Path) -> float:
    """Room for ordinary users on the disk of a directory, or of the nearest one above it that is there."""
    stats = os.statvfs(existing(directory))
    return stats.f_bavail * stats.f_frsize / 1e9


def memory_mb() -> float:
    """Memory of this process that is in use, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6
