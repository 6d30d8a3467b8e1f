"""Execution of slow methods in the background, one at a time, so that they never delay the others."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

log = logging.getLogger("fringed.control")

CAPACITY = 8


@dataclass(frozen=True, slots=True)
class Job:
    """A slow request.

    Args:
        name: for messages; run: executes it; give_up: called instead when the executor ends first.
    """

    name: str
    run: Callable[[], None]
    give_up: Callable[[], None]


class BackgroundExecutor:
    """A thread with a short queue of jobs.

    A job that never returns (a disk that hangs) blocks this thread alone, which does not keep the program from ending.
    """

    def __init__(self, *, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._jobs: deque[Job] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._running = ""
        self._thread = threading.Thread(target=self._run, name="control-background", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def running(self) -> str:
        """Name of the running job, empty when there is none."""
        return self._running

    def submit(self, job: Job) -> bool:
        """Queue a job; False when too many wait already, or after the end."""
        with self._changed:
            if self._closed or len(self._jobs) >= self._capacity:
                return False
            self._jobs.append(job)
            self._changed.notify()
            return True

    def close(self, timeout_s: float) -> bool:
        """Give up the waiting jobs and finish the running one; False when that does not return in time."""
        with self._changed:
            self._closed = True
            waiting = list(self._jobs)
            self._jobs.clear()
            self._changed.notify()
        for job in waiting:
            job.give_up()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (job := self._next()) is not None:
            try:
                job.run()
            except Exception:
                log.exception("control: %s failed", job.name)

    def _next(self) -> Job | None:
        with self._changed:
            self._running = ""
            self._changed.wait_for(lambda: self._jobs or self._closed)
            if not self._jobs:
                return None
            job = self._jobs.popleft()
            self._running = job.name
            return job
