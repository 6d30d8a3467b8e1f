"""The daemon: cameras, pairing, pipeline and sinks, started in order and stopped in the opposite order."""

from __future__ import annotations

import logging
import os
import threading
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from daemon.common import threads
from daemon.common.clock import SystemClock
from daemon.common.counters import Counters
from daemon.common.errors import DaemonError
from daemon.common.stop_event import StopEvent
from daemon.common.version import program_version
from daemon.config.rig_config import RigConfig
from daemon.live.acquisition.camera_thread import CameraThread
from daemon.live.acquisition.locked_pairer import LockedPairer, pairing_settings
from daemon.live.acquisition.pairer import Pair
from daemon.live.compatibility import projector_problem, size_problem, timing_warnings
from daemon.live.items import CloudItem, Item, PairItem, Sink, UnpairedFrame
from daemon.live.processing.reconstructor_factory import make_reconstructor, warm_up
from daemon.live.processing.worker import Reconstructs, ReconstructsSets, Worker
from daemon.live.projection.mode_controller import ModeController, Outlets
from daemon.live.status import CameraState, CameraStatus, State, Status
from daemon.rig.open_rig import Rig
from drivers.protocols import SIDES, Clock, Frame, ProjectorInfo, Side
from pipeline.common.settings import Settings
from pipeline.reconstruct.reconstructor import Reconstructor

log = logging.getLogger("fringed")

_TICK_S = 0.1
_JOIN_S = 5.0
_CHANGE_S = 20.0
_MODE_S = 180.0  # the kernels of another mode may have to be compiled


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
        self._namer = threads.ThreadNamer("fringed")
        self._sinks_lock = threading.Lock()
        self._wishes = threading.Lock()
        self._cpus_before: frozenset[int] = frozenset()
        self._last_state: State | None = None
        self._status_due_ns = 0
        limits = pairing_settings(config.pairing)
        self.pairer = LockedPairer(limits, paired=self._paired, lone=self._lone, clock=self.clock)
        self.worker = Worker(config.pipeline, emit=self.emit, drops=self.drops, clock=self.clock)
        outlets = Outlets(self.emit, self.worker.offer, self.drops, lambda: self.pairer.counter_restarts)
        self.mode_controller = ModeController(config, rig, outlets, clock=self.clock)
        self.cameras: dict[Side, CameraThread] = {
            side: CameraThread(
                side,
                rig.cameras[side],
                deliver=self.pairer.receive,
                started=self.pairer.camera_restarted,
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
            self.close()

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
        with self._wishes:
            self._paused = not wanted
            self._let_cameras()
            self.mode_controller.pause(self._paused)

    def divert(self, taker: Callable[[Pair], object] | None) -> None:
        """Hand every pair to ``taker`` alone, neither measured nor recorded; None: measure as before."""
        if taker is not None:
            self.mode_controller.hold("capture")
        with self._wishes:
            self._taker = taker
            self._let_cameras()
        if taker is None:
            self.mode_controller.release("capture")
        self._note_state()

    def _let_cameras(self) -> None:
        """With the lock of the wishes: a pause that comes at the end of a capture is not lost."""
        for camera in self.cameras.values():
            camera.measure(not self._paused or self._taker is not None)

    def reconstructor(self, settings: Settings, rig: Rig | None = None) -> Reconstructor | ReconstructsSets:
        """A reconstructor for these settings, the cameras' encoding, the mode and a rig (its own); not warmed up."""
        encodings = [self.cameras[side].status.encoding for side in SIDES]
        return make_reconstructor(
            self.config, rig or self.rig, settings, encodings, self.clock, plan=self.mode_controller.plan
        )

    def apply(self, settings: Settings) -> None:
        """Use other settings from the next pair on."""
        self.change(self.config, self.rig, settings, ())

    def change(self, config: RigConfig, rig: Rig, settings: Settings, commits: Iterable[Callable[[], None]]) -> None:
        """Take over all of this between two pairs, or nothing of it.

        Args:
            config, settings: checked, differing from what holds now in nothing that needs a restart.
            rig: the same devices, perhaps another calibration or volume.
            commits: quick, called between the same two pairs; see :class:`daemon.live.items.Changeable`.

        Raises:
            DaemonError: while starting or stopping, or when the pipeline does not get to it; PipelineError.
        """
        if not self._ready:
            raise DaemonError("the daemon is still starting; try again when it is running")
        patience_s = _CHANGE_S if config.mode == self.mode_controller.mode else _MODE_S
        with self.mode_controller.changing(config.mode):
            self.worker.replace(lambda: self._changed(config, rig, settings, commits), patience_s)

    def _changed(
        self, config: RigConfig, rig: Rig, settings: Settings, commits: Iterable[Callable[[], None]]
    ) -> Reconstructs | ReconstructsSets | None:
        """In the pipeline's thread: first what can fail, then what cannot."""
        made = None
        ways = [(c.pipeline.overload, c.pipeline.temporal_prior, c.mode) for c in (self.config, config)]
        if settings != self.settings or rig is not self.rig or ways[0] != ways[1]:
            made = self.reconstructor(settings, rig)
            if rig is not self.rig or ways[0] != ways[1]:
                warm_up(made, config.pipeline)
        self.config, self.rig, self.settings = config, rig, settings
        self.pairer.limit(pairing_settings(config.pairing))
        self.worker.configure(config.pipeline)
        for commit in commits:
            self._guarded("a change", commit)
        return made

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
        cameras: dict[str, CameraStatus] = {
            side: replace(camera.status, fates=self.pairer.outcomes(side)) for side, camera in self.cameras.items()
        }
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
            pairs=self.pairer.pairs,
            clouds=self.worker.clouds,
            pair_rate_hz=round(self.pairer.rate.per_second(now_ns), 2),
            cloud_rate_hz=round(self.worker.rate.per_second(now_ns), 2),
            points=self.worker.points,
            valid=round(self.worker.valid, 4),
            measured_every=self.worker.stride,
            latency_ms=self.worker.latency_ms.summary(),
            publish_latency_ms=sinks.get("stream", {}).pop("latency_ms", {}),
            stages_ms=self.worker.stages_ms,
            garbage=self.worker.pauses.summary(),
            drops=self.drops.snapshot(),
            cameras=cameras,
            recorder=sinks.pop("recorder", {"recording": False}),
            selfcheck={"enabled": "selfcheck" in sinks, **sinks.pop("selfcheck", {})},
            health={"enabled": "health" in sinks, **sinks.pop("health", {})},
            mode=self.mode_controller.mode,
            sequence=self.mode_controller.status(),
            sinks=sinks,
        )

    def _reasons(self) -> list[str]:
        reasons = [
            f"camera {side} is gone: {camera.status.problem}"
            for side, camera in self.cameras.items()
            if camera.status.state is CameraState.LOST
        ]
        sizes = (size_problem(side, c.status.size, self.rig.calibration) for side, c in self.cameras.items())
        reasons += filter(None, (*sizes, self.mode_controller.problem()))
        if self.worker.stride > 1:
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
        self.mode_controller.light(projector)
        for camera in self.cameras.values():
            camera.start()
        while not self._stop.is_set() and any(not camera.status.encoding for camera in self.cameras.values()):
            self._stop.wait(_TICK_S)
            self._look_up()
        if self._stop.is_set():
            return
        self.mode_controller.release("start")
        made = self.worker.start(self._warm)
        while not made.done() and not self._stop.wait(_TICK_S):
            self._look_up()
        if made.done():
            made.result()
            self._ready = not self._stop.is_set()
            self._note_state()
            for warning in self.status().warnings:
                log.warning("%s", warning)

    def _warm(self) -> Reconstructs | ReconstructsSets:
        """A reconstructor with all kernels compiled, which takes up to a minute after an update."""
        made = self.reconstructor(self.settings)
        warm_up(made, self.config.pipeline)
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
        self.pairer.tick()
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

    def close(self) -> None:
        """Close devices and sinks; :meth:`run` does so at its end."""
        self._stop.set()
        self.worker.end_changes()
        self._note_state()
        for camera in self.cameras.values():
            camera.ask_stop()
        for side, camera in self.cameras.items():
            if not camera.join(_JOIN_S):
                log.error("camera %s: its driver does not come back; left behind", side)
        self.pairer.flush()
        if not self.mode_controller.close():
            log.error("the projector's driver does not come back; left behind")
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
        log.info("stopped: %d pairs, %d clouds", self.pairer.pairs, self.worker.clouds)

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
        if self.mode_controller.takes(pair):
            return
        self.emit(PairItem(pair.left, pair.right))
        self.worker.offer(pair)

    def _lone(self, frame: Frame) -> None:
        if self._taker is None and not self.mode_controller.takes_alone():
            self.emit(UnpairedFrame(frame))

    def _note_state(self) -> None:
        state, reasons = self.state()
        if state is not self._last_state:
            self._last_state = state
            log.info("state: %s%s", state, f" ({'; '.join(reasons)})" if reasons else "")


_KINDS: dict[type, str] = {PairItem: "pairs", UnpairedFrame: "frames", CloudItem: "clouds"}
