"""Health monitoring as a sink: items are counted, the status of each second is evaluated in a low-priority thread."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from daemon.common.clock import SystemClock
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.config.rig_config import RigConfig
from daemon.live.items import CloudItem, Item, Pair
from daemon.monitoring.health.events import Event
from daemon.monitoring.health.monitor import Monitor, number_or_none
from daemon.monitoring.health.observe.clock_sync import ClockSync, clock_sync
from daemon.monitoring.health.observe.host_probe import Probe, free_gb, memory_mb
from daemon.monitoring.health.observe.illumination import Illumination
from daemon.monitoring.health.prometheus.http_server import MetricsServer
from daemon.monitoring.health.quantities import NAMES
from daemon.rig.calibration_file import created_at, load_mapping
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock

log = logging.getLogger("fringed.health")

_IDLE_S = 0.5
_JOIN_S = 5.0
_NICE = 10  # the measuring has priority
_DISK_S, _CLOCK_S = 5.0, 16.0


class Health:
    """Monitors the health of the daemon; its thread runs from construction on.

    Args:
        config: of rig.yaml; rig: its devices and calibration; base_dir: base of relative paths.

    Raises:
        DaemonError: the port of the metrics is not available.
    """

    heartbeat = None

    def __init__(self, config: RigConfig, rig: Rig, base_dir: Path, *, clock: Clock | None = None) -> None:
        self._clock: Clock = clock or SystemClock()
        self._base_dir, health = base_dir, config.health
        self.monitor = Monitor(health)
        self._metrics: MetricsServer | None = None
        if health.metrics_port is not None:
            from daemon.monitoring.health.prometheus.exposition import exposition  # loads prometheus_client

            self._metrics = MetricsServer(health.metrics_port, lambda: exposition(self.report()))
        self._illumination, self._created = Illumination(rig.calibration, rig.pattern), _created(config, rig)
        self._takes = config.path(config.recording.dir, base_dir)
        self._queue: LatestWinsQueue[CloudItem | dict[str, Any]] = LatestWinsQueue(4)
        self._due_ns = 0
        self._examined, self._ms = 0, 0.0
        self._failed: dict[str, str] = {}
        self._short = self.monitor.short()
        self._disk: Probe[float] = Probe("disk", lambda: free_gb(self._takes), period_s=_DISK_S, clock=self._clock)
        self._time: Probe[ClockSync] = Probe("clock", clock_sync, period_s=_CLOCK_S, clock=self._clock)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="health", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Count a pair or a cloud; examine the illumination of some clouds."""
        now_ns = self._clock.monotonic_ns()
        if isinstance(item, Pair):
            self.monitor.frames.pair(item, now_ns)
        elif isinstance(item, CloudItem):
            self.monitor.frames.cloud(item, now_ns)
            self._sample(item, now_ns)
        return True

    def _sample(self, item: CloudItem, now_ns: int) -> None:
        rate_hz = self.monitor.config.looks_hz
        if rate_hz > 0 and now_ns >= self._due_ns and not self._stop.is_set():
            self._due_ns = now_ns + round(1e9 / rate_hz)
            self._queue.put(item)

    def note_status(self, status: dict[str, Any]) -> None:
        """Queue the status of this second; return at once."""
        self._queue.put(status)

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        """Prepare other limits, calibration or directory of takes; history and port stay as at the start."""
        illumination, created = Illumination(rig.calibration, rig.pattern), _created(config, rig)
        takes = config.path(config.recording.dir, self._base_dir)

        def now() -> None:
            self._illumination, self._created, self._takes = illumination, created, takes
            self.monitor.configure(config.health)

        return now

    def close(self) -> None:
        """End the monitoring."""
        self._stop.set()
        self._queue.close()
        if self._metrics is not None:
            self._metrics.close()
        for probe in (self._disk, self._time):
            probe.close()
        self._thread.join(_JOIN_S)

    def status(self) -> dict[str, Any]:
        """Return the verdict and the open events; never ``problem``, which would change the state that is evaluated."""
        short = dict(self._short)
        if self._metrics is not None:
            short["metrics"] = self._metrics.address
        failed = next(iter(dict(self._failed).values()), "")
        return short | ({"failed": failed} if failed else {})

    def report(self) -> dict[str, Any]:
        """Return the whole report."""
        with self._lock:
            report = self.monitor.report(self._clock.monotonic_ns())
        return report | {"look": {"count": self._examined, "ms": round(self._ms, 2)}}

    def events(self, most: int) -> list[Event]:
        """Return the newest events."""
        with self._lock:
            return self.monitor.rules.events(most)

    def time_series(self, names: list[str], seconds: float, points: int) -> dict[str, Any]:
        """Return the history of quantities over the last ``seconds``, in at most ``points`` intervals."""
        now_s = self._clock.monotonic_ns() / 1e9
        shift_s = self._clock.realtime_ns() / 1e9 - now_s
        read = self.monitor.history.read(now_s, seconds, [NAMES.index(name) for name in names], points)
        parts = {"mean": read.mean, "low": read.low, "high": read.high}
        return {
            "period_s": read.period_s,
            "t_s": [round(t + shift_s, 3) for t in read.times_s.tolist()],
            "series": {
                name: {part: [number_or_none(v) for v in rows[:, column].tolist()] for part, rows in parts.items()}
                for column, name in enumerate(names)
            },
        }

    def _run(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        while not self._stop.is_set():
            task = self._queue.get(_IDLE_S)
            if task is not None:
                self._try("light" if isinstance(task, CloudItem) else "second", task)

    def _try(self, name: str, task: CloudItem | dict[str, Any]) -> None:
        """Execute a task; the failure of one kind does not stop the other."""
        try:
            self._examine(task) if isinstance(task, CloudItem) else self._second(task)
            self._failed.pop(name, None)
        except Exception as error:
            if name not in self._failed:
                log.exception("health: evaluating the %s failed", name)
            self._failed[name] = f"{name}: {type(error).__name__}: {error}"[:120]

    def _examine(self, item: CloudItem) -> None:
        began_ns = self._clock.monotonic_ns()
        values = self._illumination.values(item)
        self.monitor.set_illumination(began_ns / 1e9, values)
        self._examined += 1
        took_ms = (self._clock.monotonic_ns() - began_ns) / 1e6
        self._ms += (took_ms - self._ms) / min(self._examined, 20)

    def _second(self, status: dict[str, Any]) -> None:
        machine = {"memory_mb": memory_mb()}
        if (free := self._disk.value()) is not None:
            machine["disk_free_gb"] = free
        if self._created is not None:
            age_s = self._clock.realtime_ns() / 1e9 - self._created.timestamp()
            machine["calibration_age_d"] = max(0.0, age_s / 86400)
        with self._lock:
            self.monitor.second(self._clock.monotonic_ns(), status, machine, self._time.value())
            self._short = self.monitor.short()


def _created(config: RigConfig, rig: Rig) -> datetime | None:
    """Return when the calibration was made; None for that of a simulated rig, which does not age."""
    return None if config.calibration is None else created_at(load_mapping(rig.calibration_data, "calibration"))
