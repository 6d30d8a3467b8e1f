"""The measuring daemon: cameras, pairer, pipeline and sinks, started in order and stopped in the opposite order."""

from __future__ import annotations

import logging
import threading
import uuid
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from daemon.common import threads
from daemon.common.clock import SystemClock
from daemon.common.errors import DaemonError
from daemon.common.processor_share import ProcessorShare
from daemon.common.stop_event import StopEvent
from daemon.config.rig_config import RigConfig
from daemon.live.compatibility import projector_problem
from daemon.live.frame_path import FramePath, reserve_cpus
from daemon.live.housekeeping import Housekeeping, guarded
from daemon.live.items import Pair, Sink
from daemon.live.status import State, Status
from daemon.live.status_report import degraded_reasons, make_status
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock, ProjectorInfo
from pipeline.common.settings import Settings

log = logging.getLogger("fringed")

_TICK_S = 0.1
_JOIN_S = 5.0


class Service:
    """One measuring rig.

    ``run()`` blocks until :meth:`request_stop`, from any thread or a signal handler, and then has closed everything.

    Args:
        config: of the rig; rig: its devices, closed.
        sinks: by name; the service closes them.
        on_status: called with the status once a second.
        hold_cameras: accept triggers from when the kernels are ready, instead of from the start.
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
        processor_share: ProcessorShare | None = None,
        hold_cameras: bool = False,
    ) -> None:
        self.clock = clock = clock or SystemClock()
        self.processor_share = processor_share or ProcessorShare()
        self.session = session or str(uuid.uuid4())
        publish = None if on_status is None else lambda: on_status(self.status().as_dict())
        self._housekeeping = Housekeeping(self.processor_share, clock, publish)
        #: Called by the main loop ten times a second, from the start to the request to stop.
        self.on_tick = self._housekeeping.actions
        self._started_ns = clock.monotonic_ns()
        self._ready, self._paused, self._held = False, False, hold_cameras
        self._drops_starting: dict[str, int] | None = None
        self.projector: ProjectorInfo | None = None
        self._stop = StopEvent()
        self._switch = threading.Lock()
        self._cpus_before: frozenset[int] = frozenset()
        self._last_state: State | None = None
        self.path = path = FramePath(config, rig, sinks, camera_changed=self._note_state, clock=clock)
        self.router, self.pairer, self.worker, self.drops = path.router, path.pairer, path.worker, path.drops
        self.mode_controller, self.cameras = path.mode_controller, path.cameras

    @property
    def config(self) -> RigConfig:
        """The configuration that holds now."""
        return self.path.config

    @property
    def rig(self) -> Rig:
        """The rig with the calibration and volume that hold now."""
        return self.path.rig

    @property
    def settings(self) -> Settings:
        """The pipeline's settings that hold now."""
        return self.path.settings

    def run(self) -> None:
        """Measure until a stop is requested; closes devices and sinks in any case."""
        try:
            self._start()
            while not self._stop.wait(_TICK_S):
                self.pairer.tick()
                self._note_state()
                self._housekeeping.tick()
        finally:
            self.close()

    def request_stop(self) -> None:
        """Request that :meth:`run` ends; takes no lock, so that a signal handler may call it."""
        self._stop.set()

    @property
    def ready(self) -> bool:
        """Whether it measures."""
        return self._ready

    @property
    def stopping(self) -> bool:
        """Whether a stop was requested."""
        return self._stop.is_set()

    def measure(self, enabled: bool) -> None:
        """Accept triggers, or pause: everything stays connected."""
        with self._switch:
            self._paused = not enabled
            self._switch_cameras()
            self.mode_controller.pause(self._paused)

    def divert(self, consumer: Callable[[Pair], object] | None) -> None:
        """Pass every pair to ``consumer`` alone, neither measured nor recorded; None: measure as before."""
        if consumer is not None:
            self.mode_controller.hold("capture")
        with self._switch:
            self.router.diversion = consumer
            self._switch_cameras()
        if consumer is None:
            self.mode_controller.release("capture")
        self._note_state()

    def _switch_cameras(self) -> None:
        """With the lock held, so that a pause that comes at the end of a capture is not lost."""
        for camera in self.cameras.values():
            camera.measure(not (self._paused or self._held) or self.router.diversion is not None)

    def change(self, config: RigConfig, rig: Rig, settings: Settings, commits: Iterable[Callable[[], None]]) -> None:
        """Apply all of this between two pairs, or nothing of it; see :meth:`FramePath.change`."""
        if not self._ready:
            raise DaemonError("the daemon is still starting; try again when it is running")
        self.path.change(config, rig, settings, commits)

    def state(self) -> tuple[State, tuple[str, ...]]:
        """The state now and why it is degraded."""
        if self._stop.is_set():
            return State.STOPPING, ()
        reasons = degraded_reasons(self.path)
        if not self._ready:
            return State.STARTING, reasons
        if self.router.diversion is not None:
            return State.PAUSED, ("calibrating", *reasons)
        if self._paused:
            return State.PAUSED, reasons
        return (State.DEGRADED if reasons else State.RUNNING), reasons

    def status(self) -> Status:
        """State, counters, rates and latencies of everything."""
        return make_status(
            self.path,
            self.state(),
            self.projector,
            session=self.session,
            started_ns=self._started_ns,
            clock=self.clock,
            processor_share=self.processor_share,
            drops_starting=self._drops_starting,
        )

    def _start(self) -> None:
        log.info("starting: rig %s, session %s", self.config.device.name, self.session)
        self._cpus_before = reserve_cpus(self.config.pipeline.cpus)
        self.projector = projector = self.rig.projector.open()
        log.info("projector %s, %d x %d", projector.output, *projector.size)
        unfit = projector_problem(projector, self.rig.pattern)
        if unfit:
            raise DaemonError(unfit)
        self.mode_controller.light(projector)
        with self._switch:
            self._switch_cameras()
        for camera in self.cameras.values():
            camera.start()
        while not self._stop.is_set() and any(not camera.status.encoding for camera in self.cameras.values()):
            self._stop.wait(_TICK_S)
            self._housekeeping.tick()
        if self._stop.is_set():
            return
        self.mode_controller.release("start")
        started = self.worker.start(self.path.warm_reconstructor)
        while not started.done() and not self._stop.wait(_TICK_S):
            self._housekeeping.tick()
        if started.done():
            started.result()
            self._drops_starting = self.drops.snapshot()
            self._ready = not self._stop.is_set()
            with self._switch:
                self._held = False
                self._switch_cameras()
            self._note_state()
            for warning in self.status().warnings:
                log.warning("%s", warning)

    def close(self) -> None:
        """Close devices and sinks; :meth:`run` does so at its end."""
        self._stop.set()
        self.worker.end_changes()
        self.path.end_compilation()
        self._note_state()
        for camera in self.cameras.values():
            camera.request_stop()
        for side, camera in self.cameras.items():
            if not camera.join(_JOIN_S):
                log.error("camera %s: its driver hangs; its thread is left behind", side)
        self.pairer.flush()
        if not self.mode_controller.close():
            log.error("the projector's driver hangs; its thread is left behind")
        if not self.worker.stop(_JOIN_S):
            log.error("the pipeline hangs; its thread is left behind")
        self._housekeeping.publish_status()
        for name, sink in self.router.sinks.items():
            guarded(f"closing {name}", sink.close)
        guarded("closing the projector", self.rig.projector.close)
        guarded("closing the rig", self.rig.release)
        if self._cpus_before:
            threads.pin(threads.ids(), self._cpus_before)
        log.info("stopped: %d pairs, %d clouds", self.pairer.pairs, self.worker.clouds)

    def _note_state(self) -> None:
        state, reasons = self.state()
        if state is not self._last_state:
            self._last_state = state
            log.info("state: %s%s", state, f" ({'; '.join(reasons)})" if reasons else "")
