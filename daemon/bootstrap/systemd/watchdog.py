"""The conditions under which the watchdog is fed.

The main loop checks them, which shows that it runs. No thread has missed the deadline of its heartbeat, and the
pipeline takes pairs that wait for it. A pause, a missing trigger and a camera that is being reopened are regular idle
states: all threads run, nothing waits.
"""

from __future__ import annotations

from daemon.live.service import Service
from drivers.protocols import SIDES

STUCK_S = 30.0
"""How long a pair may wait for the pipeline with nothing coming out of it."""


class Watchdog:
    """Looks at one service, ten times a second at most; takes no lock."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._seen = -1
        self._moved_ns = service.clock.monotonic_ns()

    def problem(self) -> str:
        """Why life is not proven; empty while it is."""
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
        heartbeats |= {
            f"the sink {name}": sink.heartbeat for name, sink in service.sinks.items() if hasattr(sink, "heartbeat")
        }
        return [name for name, heartbeat in heartbeats.items() if heartbeat.overdue_s()]

    def _stuck(self) -> bool:
        worker, now_ns = self._service.worker, self._service.clock.monotonic_ns()
        if worker.finished != self._seen or not worker.waiting:
            self._seen, self._moved_ns = worker.finished, now_ns
        return now_ns - self._moved_ns > 1e9 * STUCK_S
