"""Make a daemon from rig.yaml and run it until a signal ends it."""

from __future__ import annotations

import logging
import signal
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from daemon.bootstrap.sighup import Reloads, hung_up, terminals
from daemon.bootstrap.sinks import open_capture, open_gate, open_health, open_publisher, open_selfcheck, open_take
from daemon.bootstrap.systemd.logging_setup import set_fields
from daemon.bootstrap.systemd.notifier import Notifier
from daemon.bootstrap.systemd.supervisor import Supervisor
from daemon.common.errors import DaemonError
from daemon.common.ipc_endpoints import runtime_beside
from daemon.config import RigConfig, load_rig
from daemon.control.calibrate_methods import CalibrateMethods
from daemon.control.health_methods import HealthMethods
from daemon.control.methods import Methods
from daemon.control.rpc.server import ControlServer
from daemon.control.sequence_capture import Capture
from daemon.live.items import Sink
from daemon.live.service import Service
from daemon.recording.recorder import Recorder
from daemon.rig.open_rig import OptionsError, Progress, open_rig

log = logging.getLogger("fringed")

_SIGNALS = signal.SIGTERM, signal.SIGINT, signal.SIGHUP


class StopRequestedError(DaemonError):
    """A stop was requested while the daemon was still being made."""


@dataclass(slots=True)
class StopFlag:
    """Turns SIGTERM and SIGINT into one orderly stop, whenever they come, and SIGHUP into a reload.

    SIGHUP of a terminal that was closed requests a stop.
    """

    requested: bool = False
    stop: Callable[[], None] | None = None
    reload: Callable[[], None] | None = None

    def request(self) -> None:
        """Stop what runs or will be started; takes no lock, so that a signal handler may call it."""
        self.requested = True
        if self.stop is not None:
            self.stop()

    @contextmanager
    def on_signals(self) -> Iterator[StopFlag]:
        """Handle the signals inside the block; only the main thread can."""
        own_terminals = terminals()

        def handle(number: int, _: FrameType | None) -> None:
            if number != signal.SIGHUP or hung_up(own_terminals):
                self.request()
            elif self.reload is not None:
                self.reload()

        before = {number: signal.signal(number, handle) for number in _SIGNALS}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def run_rig(
    path: Path,
    *,
    progress: Progress | None = None,
    flag: StopFlag | None = None,
    record: str | None = None,
    on_status: Callable[[dict[str, Any]], None] | None = None,
    hold_cameras: bool = False,
) -> None:
    """Measure with the rig of a file until a stop is requested.

    Args:
        path: of rig.yaml; record: name of a take that begins at once.
        progress: called with (done, of) while a simulated rig is rendered.
        on_status: called with the status once a second.
        hold_cameras: accept triggers from when the kernels are ready.
    """
    flag = flag or StopFlag()
    config, base_dir = load_rig(path), path.resolve().parent
    supervisor = Supervisor(Notifier.from_environment())

    def watched(done: int, of: int) -> None:
        if flag.requested:
            raise StopRequestedError("stopped while starting")
        supervisor.preparing(f"rendering the simulated rig, {done} of {of} images")
        if progress is not None:
            progress(done, of)

    try:
        rig = open_rig(config, base_dir, progress=watched)
    except StopRequestedError:
        return
    except OptionsError as error:
        raise error.located(path) from error
    try:
        _run(config, rig, path, base_dir, flag, record, on_status, supervisor, hold_cameras)
    finally:
        supervisor.close()


def _run(
    config: RigConfig,
    rig: Any,
    path: Path,
    base_dir: Path,
    flag: StopFlag,
    record: str | None,
    on_status: Callable[[dict[str, Any]], None] | None,
    supervisor: Supervisor,
    hold_cameras: bool,
) -> None:
    session = str(uuid.uuid4())
    set_fields(session=session, device=config.device.name)
    try:
        publisher = open_publisher(config, rig, session)
    except BaseException:
        rig.release()
        raise

    health: HealthMethods | None = None

    def publish(status: dict[str, Any]) -> None:
        publisher.publish_status(status)
        supervisor.note_status(status)
        if health is not None:
            health.health.note_status(status)
        if on_status is not None:
            on_status(status)

    sinks: dict[str, Sink] = {"stream": publisher}
    control: ControlServer | None = None
    try:
        if config.selfcheck.enabled:
            sinks["selfcheck"] = open_selfcheck(config, rig, base_dir)
        if config.health.enabled:
            health = HealthMethods(open_health(config, rig, base_dir))
            sinks["health"] = health.health
        service = Service(config, rig, sinks, on_status=publish, session=session, hold_cameras=hold_cameras)
        takes = config.path(config.recording.dir, base_dir)
        recorder = Recorder(
            service.router,
            config,
            lambda: service.config.path(service.config.recording.dir, base_dir),
            lambda take: open_take(
                service.config,
                service.rig,
                session,
                take,
                path,
                serials=service.path.serials,
                shown=service.mode_controller.shown,
            ),
            clock=service.clock,
        )
        capture = Capture(
            service,
            lambda file, pattern, least: open_capture(
                service.config, service.rig, session, file, pattern, serials=service.path.serials, min_free_bytes=least
            ),
            directories=(runtime_beside(config.control.endpoint) or takes, takes),
        )
        calibrate = CalibrateMethods(service, capture)
        methods = Methods(service, recorder, path=path, base_dir=base_dir, calibrate=calibrate, health=health)
        control = ControlServer(config.control.endpoint, methods.table())
        gate = open_gate(config, base_dir, publisher, control.endpoint, methods.table())
        if gate is not None:
            service.router.add_sink("remote", gate)
    except BaseException:
        if control is not None:
            control.close()
        for sink in sinks.values():
            sink.close()
        rig.release()
        raise
    control.start()
    reloads = Reloads(lambda: supervisor.reload(lambda: methods.reload({})), ready=lambda: service.ready)
    supervisor.watch(service)
    service.on_tick.append(reloads.tick)

    def stop() -> None:
        service.request_stop()
        supervisor.stopping()

    flag.stop, flag.reload = stop, reloads.request
    if flag.requested:
        service.request_stop()
    try:
        if record is not None:
            _record_at_once(service, recorder, record)
        service.run()
    finally:
        capture.close()
        control.close()


def _record_at_once(service: Service, recorder: Recorder, name: str) -> None:
    try:
        log.info("recording to %s", recorder.start(name)["file"])
    except BaseException:
        service.close()
        raise
