"""Proof of life: what must be true for the watchdog to be fed.

The main loop asks, which proves that it turns. Every thread of the measuring keeps its word (:mod:`.pulse`), and pairs
that wait for the pipeline come out of it. A pause, a missing trigger and a camera that is gone and retried are known
idle states: all threads turn, nothing waits.
"""

from __future__ import annotations

from daemon.live.service import Service
from drivers.protocols import SIDES

STUCK_S = 30.0
"""How long a pair may wait for the pipeline with nothing coming out of it."""


class Life:
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
        pulses = {"the pipeline": service.worker.pulse}
        pulses |= {f"camera {side}": service.cameras[side].pulse for side in SIDES}
        pulses |= {f"the sink {name}": sink.pulse for name, sink in service.sinks.items() if hasattr(sink, "pulse")}
        return [name for name, pulse in pulses.items() if pulse.overdue_s()]

    def _stuck(self) -> bool:
        worker, now_ns = self._service.worker, self._service.clock.monotonic_ns()
        if worker.finished != self._seen or not worker.waiting:
            self._seen, self._moved_ns = worker.finished, now_ns
        return now_ns - self._moved_ns > 1e9 * STUCK_S
