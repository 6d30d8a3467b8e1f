"""The calibration drift monitor as a sink: a thread of its own examines some of the pairs, always the newest."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from daemon.common.clock import SystemClock
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.config.rig_config import RigConfig
from daemon.config.rig_config import SelfCheck as Config
from daemon.live.items import CloudItem, Item
from daemon.monitoring.calibration_drift import explanation
from daemon.monitoring.calibration_drift.store import Store
from daemon.monitoring.calibration_drift.verdicts import Assessment, Assessor, Verdict, limits_of
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock
from pipeline.common.errors import PipelineError
from pipeline.monitor.explain import GEOMETRY, explain, unambiguous
from pipeline.monitor.observe import Observation, Observer, Reading, warm_up
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

log = logging.getLogger("fringed.selfcheck")

_IDLE_S = 0.5
_JOIN_S = 5.0
_HISTORY_NS = 60_000_000_000
_QUIET_NS = 3_000_000_000  # the consequences of one disturbance are reported once
_LEAST_LIT = 0.05
_NICE = 10  # the measuring has priority


class DriftMonitor:
    """Monitors whether the calibration still fits; its thread runs from construction on.

    Args:
        config: of rig.yaml; directory: of the history.
        calibration, pattern, volume: as of the reconstruction; identity: of the calibration.
    """

    heartbeat = None

    def __init__(
        self,
        config: Config,
        directory: Path,
        *,
        calibration: Calibration,
        pattern: ColorFringe,
        volume: Volume,
        identity: str,
        clock: Clock | None = None,
    ) -> None:
        self._config, self._directory, self._clock = config, directory, clock or SystemClock()
        self._calibration, self._pattern, self._volume, self._identity = calibration, pattern, volume, identity
        self._queue: LatestWinsQueue[CloudItem] = LatestWinsQueue(1)
        self._period_ns = round(1e9 / config.rate_hz)
        self._due_ns = 0
        self._history_due_ns = 0
        self._encoding = ""
        self._pending: tuple[Config, Rig] | None = None
        self._observer: Observer | None = None
        self._store: Store | None = None
        self._assessor = Assessor(limits_of(config.limits), {})
        self._stored = 0
        self._checked, self._ms = 0, 0.0
        self._problem, self._failed = "", ""
        self._last: Observation | None = None
        self._reported: frozenset[str] = frozenset()
        self._quiet_ns = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="selfcheck", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Take a cloud when the next check is due; only single-shot clouds of the colour fringe are examined."""
        if isinstance(item, CloudItem) and item.frames == 1:
            now_ns = self._clock.monotonic_ns()
            if now_ns >= self._due_ns and not self._stop.is_set():
                # The next one is due a period after this one was, unless the stream is slower than that.
                self._due_ns = max(self._due_ns + self._period_ns, now_ns + self._period_ns // 2)
                self._queue.put(item)
        return True

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        """Prepare for other limits, or another calibration, which has its own reference."""
        pending = (config.selfcheck, rig)

        def commit() -> None:
            self._period_ns = round(1e9 / config.selfcheck.rate_hz)
            self._queue.clear()  # a waiting cloud was measured with the calibration before
            self._pending = pending

        return commit

    def close(self) -> None:
        """Stop, and store the present state."""
        self._stop.set()
        self._queue.close()
        self._thread.join(_JOIN_S)
        if self._store is not None and self._checked:
            self._store.append(self._row("stopped"))

    def status(self) -> dict[str, Any]:
        """Return every observable with its verdict; ``problem`` describes what has drifted."""
        assessments = self._assessor.assessments
        verdicts = {one.verdict for one in assessments.values()}
        worst = next(
            (v for v in (Verdict.DRIFTED, Verdict.LEARNING, Verdict.OK) if v in verdicts), Verdict.UNOBSERVABLE
        )
        last = self._last
        return {
            "verdict": str(worst),
            "problem": self._problem or self._failed,
            "checked": self._checked,
            "ms": round(self._ms, 2),
            "patches": 0 if last is None else last.patches,
            "observables": {name: _plain(one) for name, one in assessments.items()},
        }

    def _run(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        warm_up()
        while not self._stop.is_set():
            item = self._queue.get(_IDLE_S)
            if self._apply_change() or item is None:
                continue
            try:
                self._check(item)
                self._failed = ""
            except PipelineError as error:
                self._failed = str(error)
            except Exception:
                if not self._failed:
                    log.exception("the self-check failed")
                self._failed = "the self-check failed; see the log"

    def _apply_change(self) -> bool:
        """Apply a committed change in the monitor's thread; True where the taken pair may be older than that."""
        if self._pending is None:
            return False
        (config, rig), self._pending = self._pending, None
        self._config = config
        if (rig.identity, rig.volume) == (self._identity, self._volume):
            self._assessor.set_limits(limits_of(config.limits))
            return True
        self._calibration, self._pattern = rig.calibration, rig.pattern
        self._volume, self._identity = rig.volume, rig.identity
        self._encoding = ""  # the next pair starts with a new observer
        self._problem = ""
        return True

    def _check(self, item: CloudItem) -> None:
        began_ns = self._clock.monotonic_ns()
        if item.left.encoding != self._encoding:
            self._begin(item.left.encoding)
        assert self._observer is not None  # noqa: S101 - made by _begin
        observation = self._observer.observe(item.left.image, item.right.image, item.measured)
        surface = Reading(observation.valid, 0.01) if observation.lit > _LEAST_LIT else None
        self._assessor.feed(began_ns / 1e9, observation.readings, surface=surface)
        self._last = observation
        self._checked += 1
        self._report(item)
        took_ms = (self._clock.monotonic_ns() - began_ns) / 1e6
        self._ms += (took_ms - self._ms) / min(self._checked, 20)

    def _begin(self, encoding: str) -> None:
        self._observer = Observer(self._calibration, self._pattern, self._volume, encoding=encoding)
        self._encoding = encoding
        pattern = hashlib.sha256(json.dumps(self._pattern.as_mapping(), sort_keys=True).encode()).hexdigest()
        self._store = Store(self._directory, f"{self._identity} {pattern[:16]} {encoding}")
        references = self._store.references()
        self._assessor = Assessor(limits_of(self._config.limits), references)
        self._stored, self._reported = len(references), frozenset()

    def _report(self, item: CloudItem) -> None:
        """Log and store what has changed."""
        assert self._store is not None  # noqa: S101 - made by _begin
        references = self._assessor.references
        if len(references) != self._stored:
            self._stored = len(references)
            self._store.save(references, item.t_ns)
        drifted = self._assessor.drifted
        self._problem = explanation.describe(drifted, self._cause()) if drifted else ""
        now = frozenset(drifted)
        now_ns = self._clock.monotonic_ns()
        if now - self._reported and now_ns >= self._quiet_ns:
            log.warning("self-check: %s", self._problem)
            self._store.append(self._row("drifted", item))
            self._reported, self._quiet_ns = now, now_ns + _QUIET_NS
        elif self._reported and not now:
            log.info("self-check: the rig matches its calibration again")
            self._store.append(self._row("ok", item))
            self._reported, self._quiet_ns = now, now_ns
        if now_ns >= self._history_due_ns:
            self._history_due_ns = now_ns + _HISTORY_NS
            self._store.append(self._row("check", item))

    def _cause(self) -> str:
        """Describe the device whose turn explains the changes; empty where none does, or more than one."""
        changes = {
            name: Reading(now.change, now.sigma)
            for name, now in self._assessor.assessments.items()
            if name in GEOMETRY and math.isfinite(now.change)
        }
        if self._last is None or not len(self._last.shape) or len(changes) < len(GEOMETRY) or self._observer is None:
            return ""
        return explanation.describe_cause(
            unambiguous(explain(self._calibration, self._last.shape, self._observer.first, changes))
        )

    def _row(self, event: str, item: CloudItem | None = None) -> dict[str, Any]:
        row: dict[str, Any] = {"t_ns": self._clock.realtime_ns(), "event": event, "calibration": self._identity}
        if item is not None:
            row["seq"] = item.seq
            row["saturated"] = [round(share, 4) for share in item.measured.saturated]
            row["modulation"] = [float(np.median(plane[::8, ::8])) for plane in item.measured.modulation]
        if self._problem:
            row["problem"] = self._problem
        return row | {"observables": {name: _plain(one) for name, one in self._assessor.assessments.items()}}


def _plain(now: Assessment) -> dict[str, Any]:
    """Return values for JSON; unknown numbers are left out."""
    numbers = {"value": now.value, "sigma": now.sigma, "change": now.change, "limit": now.limit}
    return {"verdict": str(now.verdict)} | {k: round(v, 5) for k, v in numbers.items() if math.isfinite(v)}
