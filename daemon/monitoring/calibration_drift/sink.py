"""The self-check as a sink: a thread of its own that looks at some of the pairs; the newest wins, nothing waits."""

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
from daemon.monitoring.calibration_drift.verdicts import Found, Verdict, Watch, limits_of
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock
from pipeline.common.errors import PipelineError
from pipeline.monitor.explain import GEOMETRY, clear, explain
from pipeline.monitor.observe import Observation, Observer, Reading, warm_up
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

log = logging.getLogger("fringed.selfcheck")

_IDLE_S = 0.5
_JOIN_S = 5.0
_HISTORY_NS = 60_000_000_000
_QUIET_NS = 3_000_000_000  # what follows from the same knock is told once
_LEAST_LIT = 0.05
_NICE = 10  # the measurement goes first


class SelfCheck:
    """Watches whether the calibration still fits; running once it is made.

    Args:
        config: of rig.yaml; directory: of the history.
        calibration, pattern, volume: as of the reconstruction; identity: of the calibration.
    """

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
        self._box: LatestWinsQueue[CloudItem] = LatestWinsQueue(1)
        self._period_ns = round(1e9 / config.rate_hz)
        self._due_ns = 0
        self._history_due_ns = 0
        self._encoding = ""
        self._fresh: tuple[Config, Rig] | None = None
        self._observer: Observer | None = None
        self._store: Store | None = None
        self._watch = Watch(limits_of(config.limits), {})
        self._kept = 0
        self._checked, self._ms = 0, 0.0
        self._problem, self._failed = "", ""
        self._last: Observation | None = None
        self._told: frozenset[str] = frozenset()
        self._quiet_ns = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="selfcheck", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Take a cloud when the next check is due; only a single image of the colour fringe tells anything."""
        if isinstance(item, CloudItem) and item.frames == 1:
            now_ns = self._clock.monotonic_ns()
            if now_ns >= self._due_ns and not self._stop.is_set():
                # The next one is due a period after this one was, unless the stream is slower than that.
                self._due_ns = max(self._due_ns + self._period_ns, now_ns + self._period_ns // 2)
                self._box.put(item)
        return True

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        """Prepare for other limits, or another calibration: its reference is another one, perhaps to be learned."""
        fresh = (config.selfcheck, rig)

        def commit() -> None:
            self._period_ns = round(1e9 / config.selfcheck.rate_hz)
            self._box.clear()  # what waits was measured with the calibration before
            self._fresh = fresh

        return commit

    def close(self) -> None:
        """Stop, and keep what is known."""
        self._stop.set()
        self._box.close()
        self._thread.join(_JOIN_S)
        if self._store is not None and self._checked:
            self._store.note(self._row("stopped"))

    def status(self) -> dict[str, Any]:
        """Every observable with its verdict; ``problem`` tells what has drifted."""
        found = self._watch.found
        verdicts = {one.verdict for one in found.values()}
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
            "observables": {name: _plain(one) for name, one in found.items()},
        }

    def _run(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        warm_up()
        while not self._stop.is_set():
            item = self._box.get(_IDLE_S)
            if self._take_over() or item is None:
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

    def _take_over(self) -> bool:
        """In the thread of the checks: use what was committed; True: the pair at hand may be older than that."""
        if self._fresh is None:
            return False
        (config, rig), self._fresh = self._fresh, None
        self._config = config
        if (rig.identity, rig.volume) == (self._identity, self._volume):
            self._watch.limit(limits_of(config.limits))
            return True
        self._calibration, self._pattern = rig.calibration, rig.pattern
        self._volume, self._identity = rig.volume, rig.identity
        self._encoding = ""  # the next pair begins anew
        self._problem = ""
        return True

    def _check(self, item: CloudItem) -> None:
        began_ns = self._clock.monotonic_ns()
        if item.left.encoding != self._encoding:
            self._begin(item.left.encoding)
        assert self._observer is not None  # noqa: S101 - made by _begin
        seen = self._observer.observe(item.left.image, item.right.image, item.cloud)
        surface = Reading(seen.known, 0.01) if seen.lit > _LEAST_LIT else None
        self._watch.feed(began_ns / 1e9, seen.readings, surface=surface)
        self._last = seen
        self._checked += 1
        self._note(item)
        took_ms = (self._clock.monotonic_ns() - began_ns) / 1e6
        self._ms += (took_ms - self._ms) / min(self._checked, 20)

    def _begin(self, encoding: str) -> None:
        self._observer = Observer(self._calibration, self._pattern, self._volume, encoding=encoding)
        self._encoding = encoding
        pattern = hashlib.sha256(json.dumps(self._pattern.as_mapping(), sort_keys=True).encode()).hexdigest()
        self._store = Store(self._directory, f"{self._identity} {pattern[:16]} {encoding}")
        references = self._store.references()
        self._watch = Watch(limits_of(self._config.limits), references)
        self._kept, self._told = len(references), frozenset()

    def _note(self, item: CloudItem) -> None:
        """Tell and write down what has changed."""
        assert self._store is not None  # noqa: S101 - made by _begin
        references = self._watch.references
        if len(references) != self._kept:
            self._kept = len(references)
            self._store.keep(references, item.t_ns)
        drifted = self._watch.drifted
        self._problem = explanation.told(drifted, self._guess()) if drifted else ""
        now = frozenset(drifted)
        now_ns = self._clock.monotonic_ns()
        if now - self._told and now_ns >= self._quiet_ns:
            log.warning("self-check: %s", self._problem)
            self._store.note(self._row("drifted", item))
            self._told, self._quiet_ns = now, now_ns + _QUIET_NS
        elif self._told and not now:
            log.info("self-check: the rig is as it was when it was calibrated")
            self._store.note(self._row("ok", item))
            self._told, self._quiet_ns = now, now_ns
        if now_ns >= self._history_due_ns:
            self._history_due_ns = now_ns + _HISTORY_NS
            self._store.note(self._row("check", item))

    def _guess(self) -> str:
        """Which device's turn explains the changes, in words; nothing where none does, or more than one."""
        changes = {
            name: Reading(found.change, found.sigma)
            for name, found in self._watch.found.items()
            if name in GEOMETRY and math.isfinite(found.change)
        }
        if self._last is None or not len(self._last.shape) or len(changes) < len(GEOMETRY) or self._observer is None:
            return ""
        return explanation.guess(clear(explain(self._calibration, self._last.shape, self._observer.first, changes)))

    def _row(self, event: str, item: CloudItem | None = None) -> dict[str, Any]:
        row: dict[str, Any] = {"t_ns": self._clock.realtime_ns(), "event": event, "calibration": self._identity}
        if item is not None:
            row["seq"] = item.seq
            row["saturated"] = [round(share, 4) for share in item.cloud.saturated]
            row["modulation"] = [float(np.median(plane[::8, ::8])) for plane in item.cloud.modulation]
        if self._problem:
            row["problem"] = self._problem
        return row | {"observables": {name: _plain(one) for name, one in self._watch.found.items()}}


def _plain(found: Found) -> dict[str, Any]:
    """Values for JSON: numbers that are not known are left out."""
    numbers = {"value": found.value, "sigma": found.sigma, "change": found.change, "limit": found.limit}
    return {"verdict": str(found.verdict)} | {k: round(v, 5) for k, v in numbers.items() if math.isfinite(v)}
