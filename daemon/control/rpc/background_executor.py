"""The extra lane of control: what may wait is carried out here, one at a time, and never holds up the other methods."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

log = logging.getLogger("fringed.control")

ROOM = 8


@dataclass(frozen=True, slots=True)
class Job:
    """Something slow.

    Args:
        name: for messages; run: does it; give_up: is called in its place when the lane ends first.
    """

    name: str
    run: Callable[[], None]
    give_up: Callable[[], None]


class BackgroundExecutor:
    """A thread and a short queue of jobs.

    A job that never comes back (a disk that hangs) costs this lane alone, and its thread does not keep the program
    from ending.
    """

    def __init__(self, *, room: int = ROOM) -> None:
        self._room = room
        self._jobs: deque[Job] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._doing = ""
        self._thread = threading.Thread(target=self._run, name="control-lane", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    @property
    def doing(self) -> str:
        """The name of the job at hand, empty when there is none."""
        return self._doing

    def submit(self, job: Job) -> bool:
        """Take a job; False when too many wait already, or after the end."""
        with self._changed:
            if self._closed or len(self._jobs) >= self._room:
                return False
            self._jobs.append(job)
            self._changed.notify()
            return True

    def close(self, timeout_s: float) -> bool:
        """Give up the jobs that wait, finish the one at hand; False when that does not come back in time."""
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
            self._doing = ""
            self._changed.wait_for(lambda: self._jobs or self._closed)
            if not self._jobs:
                return None
            job = self._jobs.popleft()
            self._doing = job.name
            return job
