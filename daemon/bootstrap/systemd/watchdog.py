"""The conditions under which the service manager's watchdog is fed.

The main loop checks them, which shows that it runs. No thread has missed the deadline of its heartbeat, and the
pipeline takes pairs that wait for it. A pause, a missing trigger and a camera that is being reopened are regular idle
states: all threads run, nothing waits.
"""

from __future__ import annotations

from daemon.live.service import Service
from drivers.protocols import SIDES

STUCK_S = 30.0
"""How long a pair may wait for the pipeline while none is measured."""


class Watchdog:
    """Checks one service, ten times a second at most; takes no lock."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._finished = -1
        self._progress_ns = service.clock.monotonic_ns()

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
        return [name for name, heartbeat in heartbeats.items() if heartbeat.overdue_s()]

    def _stuck(self) -> bool:
        worker, now_ns = self._service.worker, self._service.clock.monotonic_ns()
        if worker.finished != self._finished or not worker.waiting:
            self._finished, self._progress_ns = worker.finished, now_ns
        return now_ns - self._progress_ns > 1e9 * STUCK_S
