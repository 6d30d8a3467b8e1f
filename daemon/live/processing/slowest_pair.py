"""Where the time of the slowest recent pair went."""

from __future__ import annotations

from typing import Any

from daemon.live.items import CloudItem

_WINDOW_NS = 300_000_000_000


class SlowestPair:
    """The cloud with the longest latency of the last five to ten minutes."""

    def __init__(self) -> None:
        self._since_ns = 0
        self._now: dict[str, Any] = {}
        self._before: dict[str, Any] = {}

    def note(self, item: CloudItem, began_ns: int, now_ns: int) -> None:
        """Compare a cloud with the slowest one.

        Args:
            began_ns: when its measurement began, CLOCK_REALTIME; now_ns: monotonic.
        """
        if now_ns - self._since_ns > _WINDOW_NS:
            self._since_ns, self._before, self._now = now_ns, self._now, {}
        if self._now and item.latency_ms <= self._now["latency_ms"]:
            return
        arrival_ms, waiting_ms = (item.t_arrived_ns - item.t_ns) / 1e6, (began_ns - item.t_arrived_ns) / 1e6
        times = {
            "latency_ms": item.latency_ms,
            "arrival_ms": arrival_ms,
            "waiting_ms": waiting_ms,
            "measuring_ms": item.latency_ms - arrival_ms - waiting_ms,
        }
        self._now = {"seq": item.seq, "t_ns": item.t_ns} | {name: round(ms, 3) for name, ms in times.items()}
        self._now["stages_ms"] = {name: round(ms, 2) for name, ms in item.cloud.ms.items()}

    def summary(self) -> dict[str, Any]:
        """Trigger number, start of exposure and times of it; empty before the first cloud.

        ``latency_ms`` is the sum of ``arrival_ms`` (start of exposure to the arrival of both frames), ``waiting_ms``
        (pairing and the queue of the pipeline) and ``measuring_ms``, of which ``stages_ms`` is a part.
        """
        now, before = self._now, self._before
        return before if before and before["latency_ms"] > now.get("latency_ms", 0.0) else now
