"""The daemon: cameras, pairing, pipeline and sinks, started in order and stopped in the opposite order."""

from __future__ import annotations

import logging
import os
import threading
import uuid
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from typing import Any

from daemon import threads
from daemon.acquisition import CameraThread
from daemon.clock import SystemClock
from daemon.config.models import RigConfig
from daemon.counters import Counters
from daemon.errors import DaemonError
from daemon.pairing import Pair, PairingSettings
from daemon.pairing_desk import PairingDesk
from daemon.rig import Rig
from daemon.sinks import CloudItem, Item, LoneItem, PairItem, Sink
from daemon.status import CameraState, CameraStatus, State, Status
from daemon.stop import StopEvent
from daemon.suitability import projector_problem, size_problem, timing_warnings
from daemon.worker import Worker
from drivers.protocols import SIDES, Clock, Frame, ProjectorInfo, Side
from pipeline.reconstruct import Reconstructor
from pipeline.settings import Settings

log = logging.getLogger("fringed")

_TICK_S = 0.1
_JOIN_S = 5.0
_CHANGE_S = 20.0


class Service:
    """One measuring rig.

    ``run()`` blocks until :meth:`ask_stop`, from any thread or a signal handler, and then has closed everything.

    Args:
        config: of the rig; rig: its devices, closed.
        sinks: by name; the service closes them.
        on_status: told the status once a second.
    """

    def __init__(
        self,
        config: RigConfig,
        rig: Rig,
        sinks: Mapping[str, Sink],
        *,
        on_status: Callable[[dict[str, Any]], None] | None = None,
        clock: Clock | None = None,
        session: str | None = None,
    ) -> None:
        self.config, self.rig = config, rig
        self.sinks: dict[str, Sink] = dict(sinks)
        self.clock = clock or SystemClock()
        self.session = session or str(uuid.uuid4())
        self.settings = Settings().with_overrides(config.pipeline.settings)
        self.drops = Counters()
        self._on_status = on_status
        #: Called by the main loop ten times a second, from the start to the wish to stop.
        self.on_tick: list[Callable[[], None]] = []
        self._started_ns = self.clock.monotonic_ns()
        self._ready, self._paused = False, False
        self._taker: Callable[[Pair], object] | None = None
        self.projector: ProjectorInfo | None = None
        self._stop = StopEvent()
        self._namer = threads.Namer("fringed")
        self._sinks_lock = threading.Lock()
        self._cpus_before: frozenset[int] = frozenset()
        self._last_state: State | None = None
        self._status_due_ns = 0
        limits = PairingSettings(
            tolerance_ns=round(1000 * config.pairing.tolerance_us),
            max_wait_ns=round(1e6 * config.pairing.max_wait_ms),
            resync_after=config.pairing.resync_after,
        )
        self.desk = PairingDesk(limits, paired=self._paired, lone=self._lone, clock=self.clock)
        self.worker = Worker(config.pipeline, emit=self.emit, drops=self.drops, clock=self.clock)
        self.cameras: dict[Side, CameraThread] = {
            side: CameraThread(
                side,
                rig.cameras[side],
                deliver=self.desk.receive,
                started=self.desk.doubt,
                changed=self._note_state,
                clock=self.clock,
            )
            for side in SIDES
        }

    def run(self) -> None:
        """Measure until asked to stop; closes devices and sinks whatever happens."""
        try:
            self._start()
            while not self._stop.wait(_TICK_S):
                self._tick()
        finally:
            self._shut_down()

    def ask_stop(self) -> None:
        """Let :meth:`run` come to its end; takes no lock, so that a signal handler may call it."""
        self._stop.set()

    @property
    def ready(self) -> bool:
        """Whether it can measure by now."""
        return self._ready

    @property
    def stopping(self) -> bool:
        """Whether it was asked to stop."""
        return self._stop.is_set()

    def measure(self, wanted: bool) -> None:
        """Accept triggers, or pause: everything stays connected."""
        self._paused = not wanted
        for camera in self.cameras.values():
            camera.measure(wanted or self._taker is not None)

    def divert(self, taker: Callable[[Pair], object] | None) -> None:
        """Hand every pair to ``taker`` alone, neither measured nor recorded; None: measure as before."""
        self._taker = taker
        self.measure(not self._paused)
        self._note_state()

    def reconstructor(self, settings: Settings) -> Reconstructor:
        """A reconstructor for these settings and the cameras' encoding; not warmed up."""
        encodings = {self.cameras[side].status.encoding for side in SIDES}
        if len(encodings) != 1 or "" in encodings:
            raise DaemonError(f"the cameras send {sorted(encodings)}; both must send the same encoding")
        return Reconstructor(
            self.rig.calibration,
            self.rig.pattern,
            self.rig.volume,
            encoding=encodings.pop(),
            settings=settings,
            clock=self.clock.monotonic_ns,
            threads=self.config.pipeline.threads or len(self.config.pipeline.cpus),
        )

    def apply(self, settings: Settings) -> None:
        """Use other settings from the next pair on."""
        if not self._ready:
            raise DaemonError("the daemon is still starting; try again when it is running")
        self.worker.replace(lambda: self.reconstructor(settings), _CHANGE_S)
        self.settings = settings

    def add_sink(self, name: str, sink: Sink) -> None:
        """Offer everything to this sink too."""
        with self._sinks_lock:
            self.sinks = self.sinks | {name: sink}

    def remove_sink(self, name: str) -> Sink | None:
        """Offer nothing more to a sink; the caller closes it."""
        with self._sinks_lock:
            sink = self.sinks.get(name)
            self.sinks = {other: s for other, s in self.sinks.items() if other != name}
        return sink

    def emit(self, item: Item) -> None:
        """Offer an item to every sink; what a sink refuses is counted under its name."""
        for name, sink in self.sinks.items():
            try:
                if not sink.offer(item):
                    self.drops.add(f"{_KINDS[type(item)]}_{name}_busy")
            except Exception:  # a sink's bug must not look like a camera's or the pipeline's
                self.drops.add(f"{_KINDS[type(item)]}_{name}_failed")
                log.exception("%s cannot take an item", name)

    def state(self) -> tuple[State, tuple[str, ...]]:
        """The state now and why it is degraded."""
        if self._stop.is_set():
            return State.STOPPING, ()
        reasons = tuple(self._reasons())
        if not self._ready:
            return State.STARTING, reasons
        if self._taker is not None:
            return State.PAUSED, ("calibrating", *reasons)
        if self._paused:
            return State.PAUSED, reasons
        return (State.DEGRADED if reasons else State.RUNNING), reasons

    def status(self) -> Status:
        """Everything worth knowing at this moment."""
        state, reasons = self.state()
        now_ns = self.clock.monotonic_ns()
        sinks = {name: sink.status() for name, sink in self.sinks.items()}
        cameras: dict[str, CameraStatus] = {side: self._camera_status(side) for side in SIDES}
        return Status(
            state=state,
            reasons=reasons,
            warnings=tuple(timing_warnings(self.projector.refresh_hz if self.projector else 0.0, cameras)),
            device=self.config.device.name,
            session=self.session,
            version=program_version(),
            pid=os.getpid(),
            t_ns=self.clock.realtime_ns(),
            uptime_s=round((now_ns - self._started_ns) / 1e9, 1),
            calibration=self.rig.identity,
            pairs=self.desk.pairs,
            clouds=self.worker.clouds,
            pair_rate_hz=round(self.desk.rate.per_second(now_ns), 2),
            cloud_rate_hz=round(self.worker.rate.per_second(now_ns), 2),
            points=self.worker.points,
            valid=round(self.worker.valid, 4),
            measured_every=self.worker.every,
            latency_ms=self.worker.latency_ms.summary(),
            publish_latency_ms=sinks.get("stream", {}).pop("latency_ms", {}),
            stages_ms=self.worker.stages_ms,
            garbage=self.worker.pauses.summary(),
            drops=self.drops.snapshot(),
            cameras=cameras,
            recorder=sinks.pop("recorder", {"recording": False}),
            selfcheck={"enabled": "selfcheck" in sinks, **sinks.pop("selfcheck", {})},
            sinks=sinks,
        )

    def _camera_status(self, side: Side) -> CameraStatus:
        return replace(self.cameras[side].status, fates=self.desk.fates(side))

    def _reasons(self) -> list[str]:
        reasons = [
            f"camera {side} is gone: {camera.status.problem}"
            for side, camera in self.cameras.items()
            if camera.status.state is CameraState.LOST
        ]
        reasons += filter(
            None, (size_problem(side, c.status.size, self.rig.calibration) for side, c in self.cameras.items())
        )
        dark = self.rig.projector.problem()
        if dark:
            reasons.append(f"projector: {dark}")
        if self.worker.every > 1:
            reasons.append("the pipeline is overloaded: every second pixel is measured")
        for name, sink in self.sinks.items():
            problem = sink.status().get("problem")
            if problem:
                reasons.append(f"{name}: {problem}")
        return reasons

    def _start(self) -> None:
        log.info("starting: rig %s, session %s", self.config.device.name, self.session)
        self._keep_off()
        projector = self.rig.projector.open()
        log.info("projector %s, %d x %d", projector.output, *projector.size)
        unfit = projector_problem(projector, self.rig.pattern)
        if unfit:
            raise DaemonError(unfit)
        self.projector = projector
        self.rig.projector.show(self.rig.pattern.picture(self.rig.calibration.response))
        for camera in self.cameras.values():
            camera.start()
        while not self._stop.is_set() and any(not camera.status.encoding for camera in self.cameras.values()):
            self._stop.wait(_TICK_S)
            self._look_up()
        if self._stop.is_set():
            return
        made = self.worker.start(self._warm)
        while not made.done() and not self._stop.wait(_TICK_S):
            self._look_up()
        if made.done():
            made.result()
            self._ready = not self._stop.is_set()
            self._note_state()
            for warning in self.status().warnings:
                log.warning("%s", warning)

    def _warm(self) -> Reconstructor:
        """A reconstructor with all kernels compiled, which takes up to a minute after an update."""
        made = self.reconstructor(self.settings)
        pipeline = self.config.pipeline
        made.warm_up(every=(1, 2) if pipeline.overload == "half" else (1,), follow=pipeline.temporal_prior)
        return made

    def _keep_off(self) -> None:
        """Keep everything that is not the pipeline off its processors, as far as there are others."""
        wanted, there = frozenset(self.config.pipeline.cpus), threads.available()
        if wanted - there:
            raise DaemonError(f"pipeline.cpus: {sorted(wanted - there)} cannot be used, there are {sorted(there)}")
        if wanted and there - wanted:
            threads.pin(threads.ids(), there - wanted)
            self._cpus_before = there

    def _tick(self) -> None:
        self.desk.tick()
        self._note_state()
        self._look_up()

    def _look_up(self) -> None:
        """What the main loop does besides, in every state."""
        for action in self.on_tick:
            self._guarded("looking after the daemon", action)
        self._publish_status()

    def _publish_status(self) -> None:
        now_ns = self.clock.monotonic_ns()
        if now_ns >= self._status_due_ns:
            self._status_due_ns = now_ns + 1_000_000_000
            self._namer.update()
            if self._on_status is not None:
                self._tell(self._on_status)

    def _tell(self, on_status: Callable[[dict[str, Any]], None]) -> None:
        self._guarded("telling the status", lambda: on_status(self.status().as_dict()))

    def _shut_down(self) -> None:
        self._stop.set()
        self._note_state()
        for camera in self.cameras.values():
            camera.ask_stop()
        for side, camera in self.cameras.items():
            if not camera.join(_JOIN_S):
                log.error("camera %s: its driver does not come back; left behind", side)
        self.desk.flush()
        if not self.worker.stop(_JOIN_S):
            log.error("the pipeline does not come back; left behind")
        if self._on_status is not None:
            self._tell(self._on_status)
        for name, sink in self.sinks.items():
            self._guarded(f"closing {name}", sink.close)
        self._guarded("the projector", self.rig.projector.close)
        self._guarded("the rig", self.rig.release)
        if self._cpus_before:
            threads.pin(threads.ids(), self._cpus_before)
        log.info("stopped: %d pairs, %d clouds", self.desk.pairs, self.worker.clouds)

    def _guarded(self, what: str, action: Callable[[], object]) -> None:
        """One failure must not keep the rest from being done."""
        try:
            action()
        except Exception:
            log.exception("%s failed", what)

    def _paired(self, pair: Pair) -> None:
        taker = self._taker
        if taker is not None:
            taker(pair)
            return
        self.emit(PairItem(pair.left, pair.right))
        self.worker.offer(pair)

    def _lone(self, frame: Frame) -> None:
        if self._taker is None:
            self.emit(LoneItem(frame))

    def _note_state(self) -> None:
        state, reasons = self.state()
        if state is not self._last_state:
            self._last_state = state
            log.info("state: %s%s", state, f" ({'; '.join(reasons)})" if reasons else "")


_KINDS: dict[type, str] = {PairItem: "pairs", LoneItem: "frames", CloudItem: "clouds"}


def program_version() -> str:
    """The installed version of the project."""
    try:
        return version_of("fringed")
    except PackageNotFoundError:
        return "unknown"
