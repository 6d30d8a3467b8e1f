"""The conditions under which the service manager's watchdog is fed.

The main loop checks them, which shows that it runs. No thread has missed the deadline of its heartbeat, and the
pipeline takes pairs that wait for it. A pause, a missing trigger and a camera that is being reopened are regular idle
states: all threads run, nothing waits.

A deadline counts time in which this process had processors: what other programs took from it extends the deadline
(:mod:`daemon.common.processor_share`). A thread that hangs on an otherwise idle machine misses it at the same moment as
before, since nothing is taken from a process that waits for nothing.
"""

from __future__ import annotations

from daemon.common.heartbeat import Heartbeat
from daemon.live.service import Service
from drivers.protocols import SIDES

STUCK_S = 30.0
"""How long a pair may wait for the pipeline while none is measured."""


class Watchdog:
    """Checks one service, ten times a second at most; takes no lock."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._finished = -1
        self._progress_ns = self._available_ns()
        #: By name: the deadline of the present turn, and the lost time when it was first seen.
        self._turns: dict[str, tuple[int | None, int]] = {}
        self._lost_before_ns = 0

    def problem(self) -> str:
        """Which condition is not met; empty when all are."""
        late = self._late()
        if late:
            return f"{' and '.join(late)} does not answer" if len(late) == 1 else f"{' and '.join(late)} do not answer"
        if self._stuck():
            return f"pairs wait for the pipeline and none was measured for {STUCK_S:.0f} s"
        return ""

    def _late(self) -> list[str]:
        service = self._service
        heartbeats = {"the pipeline": service.worker.heartbeat}
        heartbeats |= {f"camera {side}": service.cameras[side].heartbeat for side in SIDES}
        sinks = service.router.sinks.items()
        heartbeats |= {f"the sink {name}": sink.heartbeat for name, sink in sinks if sink.heartbeat is not None}
        late = [name for name, heartbeat in heartbeats.items() if self._missed(name, heartbeat)]
        self._lost_before_ns = service.processor_share.lost_ns
        return late

    def _missed(self, name: str, heartbeat: Heartbeat) -> bool:
        """Whether a deadline is missed by more than the time that this process lost during the turn."""
        due_ns, overdue_s = heartbeat.due_ns, heartbeat.overdue_s()
        # The turn began after the last tick, so that all that was lost since then may belong to it.
        seen_ns, since_ns = self._turns.get(name, (due_ns, self._lost_before_ns))
        if seen_ns != due_ns:
            since_ns = self._lost_before_ns
        self._turns[name] = due_ns, since_ns
        return 1e9 * overdue_s > self._service.processor_share.lost_ns - since_ns

    def _stuck(self) -> bool:
        worker, now_ns = self._service.worker, self._available_ns()
        if worker.finished != self._finished or not worker.waiting:
            self._finished, self._progress_ns = worker.finished, now_ns
        return now_ns - self._progress_ns > 1e9 * STUCK_S

    def _available_ns(self) -> int:
        """Time without what other programs took."""
        return self._service.clock.monotonic_ns() - self._service.processor_share.lost_ns
