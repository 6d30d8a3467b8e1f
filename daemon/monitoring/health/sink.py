"""Health as a sink: items are noted, the status of every second is judged, all of it in a thread of low priority."""

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
from daemon.live.items import CloudItem, Item, PairItem
from daemon.monitoring.health.events import Event
from daemon.monitoring.health.monitor import Monitor, known
from daemon.monitoring.health.observe.clock_sync import ClockSync, clock_sync
from daemon.monitoring.health.observe.host_probe import Probe, free_gb, memory_mb
from daemon.monitoring.health.observe.illumination import Light
from daemon.monitoring.health.prometheus.exposition import exposition
from daemon.monitoring.health.prometheus.http_server import MetricsServer
from daemon.monitoring.health.quantities import NAMES
from daemon.rig.calibration_file import created_at, load_mapping
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock

log = logging.getLogger("fringed.health")

_IDLE_S = 0.5
_JOIN_S = 5.0
_NICE = 10  # the measurement goes first
_DISK_S, _CLOCK_S = 5.0, 16.0


class Health:
    """Watches how the daemon fares; running once it is made.

    Args:
        config: of rig.yaml; rig: what is measured with; base_dir: where relative paths start.

    Raises:
        DaemonError: the port of the metrics cannot be had.
    """

    def __init__(self, config: RigConfig, rig: Rig, base_dir: Path, *, clock: Clock | None = None) -> None:
        self._clock: Clock = clock or SystemClock()
        self._base_dir, health = base_dir, config.health
        self.monitor = Monitor(health)
        self._metrics = None if health.metrics_port is None else MetricsServer(health.metrics_port, self.metrics)
        self._light, self._created = Light(rig.calibration, rig.pattern), _created(config, rig)
        self._takes = config.path(config.recording.dir, base_dir)
        self._box: LatestWinsQueue[CloudItem | dict[str, Any]] = LatestWinsQueue(4)
        self._due_ns = 0
        self._looks, self._ms = 0, 0.0
        self._failed: dict[str, str] = {}
        self._short = self.monitor.short()
        self._disk: Probe[float] = Probe("disk", lambda: free_gb(self._takes), period_s=_DISK_S, clock=self._clock)
        self._time: Probe[ClockSync] = Probe("clock", clock_sync, period_s=_CLOCK_S, clock=self._clock)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="health", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Note a pair or a cloud; some clouds are looked at closely."""
        now_ns = self._clock.monotonic_ns()
        if isinstance(item, PairItem):
            self.monitor.frames.pair(item, now_ns)
        elif isinstance(item, CloudItem):
            self.monitor.frames.cloud(item, now_ns)
            self._choose(item, now_ns)
        return True

    def _choose(self, item: CloudItem, now_ns: int) -> None:
        looks_hz = self.monitor.config.looks_hz
        if looks_hz > 0 and now_ns >= self._due_ns and not self._stop.is_set():
            self._due_ns = now_ns + round(1e9 / looks_hz)
            self._box.put(item)

    def note_status(self, status: dict[str, Any]) -> None:
        """Take the status of this second; returns at once."""
        self._box.put(status)

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        """Other limits, another calibration, other takes; history and port stay as they were at the start."""
        light, created = Light(rig.calibration, rig.pattern), _created(config, rig)
        takes = config.path(config.recording.dir, self._base_dir)

        def now() -> None:
            self._light, self._created, self._takes = light, created, takes
            self.monitor.configure(config.health)

        return now

    def close(self) -> None:
        """Stop watching."""
        self._stop.set()
        self._box.close()
        if self._metrics is not None:
            self._metrics.close()
        for probe in (self._disk, self._time):
            probe.close()
        self._thread.join(_JOIN_S)

    def status(self) -> dict[str, Any]:
        """The verdict and what is open; never the key ``problem``: health judges the state, it is no part of it."""
        short = dict(self._short)
        if self._metrics is not None:
            short["metrics"] = self._metrics.address
        failed = next(iter(dict(self._failed).values()), "")
        return short | ({"failed": failed} if failed else {})

    def report(self) -> dict[str, Any]:
        """Everything that is known now."""
        with self._lock:
            whole = self.monitor.report(self._clock.monotonic_ns())
        return whole | {"look": {"count": self._looks, "ms": round(self._ms, 2)}}

    def events(self, most: int) -> list[Event]:
        """The newest events."""
        with self._lock:
            return self.monitor.judge.events(most)

    def time_series(self, names: list[str], seconds: float, points: int) -> dict[str, Any]:
        """How these quantities went over the last ``seconds``, in at most so many pieces."""
        now_s = self._clock.monotonic_ns() / 1e9
        shift_s = self._clock.realtime_ns() / 1e9 - now_s
        read = self.monitor.history.read(now_s, seconds, [NAMES.index(name) for name in names], points)
        parts = {"mean": read.mean, "low": read.low, "high": read.high}
        return {
            "period_s": read.period_s,
            "t_s": [round(t + shift_s, 3) for t in read.times_s.tolist()],
            "series": {
                name: {part: [known(v) for v in rows[:, column].tolist()] for part, rows in parts.items()}
                for column, name in enumerate(names)
            },
        }

    def metrics(self) -> str:
        """Everything that is known now, as Prometheus reads it."""
        return exposition(self.report())

    def _run(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        while not self._stop.is_set():
            got = self._box.get(_IDLE_S)
            if got is None:
                continue
            self._try("light" if isinstance(got, CloudItem) else "second", got)

    def _try(self, what: str, got: CloudItem | dict[str, Any]) -> None:
        """One that cannot be told must not silence the other."""
        try:
            self._look(got) if isinstance(got, CloudItem) else self._second(got)
            self._failed.pop(what, None)
        except Exception as error:
            if what not in self._failed:
                log.exception("health: the %s cannot be told", what)
            self._failed[what] = f"{what}: {type(error).__name__}: {error}"[:120]

    def _look(self, item: CloudItem) -> None:
        began_ns = self._clock.monotonic_ns()
        values = self._light.values(item)
        self.monitor.lit(began_ns / 1e9, values)
        self._looks += 1
        took_ms = (self._clock.monotonic_ns() - began_ns) / 1e6
        self._ms += (took_ms - self._ms) / min(self._looks, 20)

    def _second(self, status: dict[str, Any]) -> None:
        machine = {"memory_mb": memory_mb()}
        if (free := self._disk.answer()) is not None:
            machine["disk_free_gb"] = free
        if self._created is not None:
            age_s = self._clock.realtime_ns() / 1e9 - self._created.timestamp()
            machine["calibration_age_d"] = max(0.0, age_s / 86400)
        with self._lock:
            self.monitor.second(self._clock.monotonic_ns(), status, machine, self._time.answer())
            self._short = self.monitor.short()


def _created(config: RigConfig, rig: Rig) -> datetime | None:
    """When the calibration was made; a simulated rig makes its own one, which does not grow old."""
    return None if config.calibration is None else created_at(load_mapping(rig.calibration_data, "calibration"))
