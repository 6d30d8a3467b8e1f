"""Ready with the first cloud, the status line, and a watchdog that depends on the heartbeats of all threads."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from daemon.bootstrap.systemd.notifier import Notifier
from daemon.bootstrap.systemd.supervisor import Supervisor
from daemon.common.processor_share import ProcessorShare
from daemon.live.service import Service
from sim.devices.open_rig import RigDevices
from tests.daemon.bootstrap.systemd.manager import PATIENT, Manager
from tests.daemon.rigs import Collector, config, devices, rig_of, step
from tools.waiting import wait_until

pytestmark = PATIENT


@dataclass
class HandClock:
    """Monotonic time, advanced by the test."""

    now_ns: int = 1_700_000_000_000_000_000

    def monotonic_ns(self) -> int:
        return self.now_ns

    def realtime_ns(self) -> int:
        return self.now_ns

    def advance(self, seconds: float) -> None:
        self.now_ns += round(1e9 * seconds)


@dataclass
class Running:
    """A service on a stepped rig with a receiving manager; only the test advances the clock."""

    manager: Manager
    service: Service
    supervisor: Supervisor
    devices: RigDevices
    clock: HandClock
    thread: threading.Thread
    hanging: threading.Event = field(default_factory=threading.Event)
    gate: threading.Event = field(default_factory=threading.Event)

    def fed(self) -> bool:
        """Return whether the watchdog is fed during further turns of the main loop."""
        self.manager.read()
        self.turns(3)
        return any("WATCHDOG" in message for message in self.manager.read())

    def turns(self, count: int) -> None:
        """Let the main loop turn, each time with three seconds gone for the supervisor, none for the threads."""
        for _ in range(count):
            self.seconds[0] += 3.0
            before = self.ticks[0]
            wait_until(lambda before=before: self.ticks[0] >= before + 2)

    seconds: list[float] = field(default_factory=lambda: [0.0])
    ticks: list[int] = field(default_factory=lambda: [0])


@pytest.fixture
def running(tmp_path: Path, manager: Manager) -> Iterator[Running]:
    made, clock = devices(), HandClock()
    # Other programs take no time from this one, however busy the machine is: deadlines follow the test's clock alone.
    share = ProcessorShare(lambda: 0, lambda: None)
    rig, sinks = rig_of(made), {"stream": Collector()}
    service = Service(config(tmp_path, "pipeline: {queue: 16}\n"), rig, sinks, clock=clock, processor_share=share)
    seconds, ticks = [0.0], [0]
    supervisor = Supervisor(Notifier(manager.address, watchdog_s=10.0), now_s=lambda: seconds[0])
    supervisor.watch(service)
    service.on_tick.append(lambda: ticks.__setitem__(0, ticks[0] + 1))
    thread = threading.Thread(target=service.run)
    running = Running(manager, service, supervisor, made, clock, thread, seconds=seconds, ticks=ticks)
    thread.start()
    wait_until(lambda: service.ready)
    wait_until(lambda: all(c["state"] == "acquiring" for c in service.status().as_dict()["cameras"].values()))
    yield running
    running.gate.set()
    service.request_stop()
    thread.join(60)
    supervisor.close()
    assert not thread.is_alive()


def measure(running: Running) -> None:
    """Trigger a few pairs: the pairer releases the first ones after several consistent counts of both cameras."""
    for _ in range(4):
        step(running.devices)
    wait_until(lambda: running.service.worker.clouds == 4)


def test_ready_comes_with_the_first_cloud_and_not_before(running: Running) -> None:
    running.turns(3)
    assert running.manager.values("READY") == []
    assert "60000000" in running.manager.values("EXTEND_TIMEOUT_USEC")
    assert not running.supervisor.ready
    measure(running)
    running.manager.wait_for("READY")
    running.turns(3)
    assert running.manager.values("READY") == ["1"]


def test_a_missing_trigger_is_reported_in_the_status(running: Running) -> None:
    running.supervisor.note_status(running.service.status().as_dict())
    assert "waiting for the trigger" in running.manager.wait_for("STATUS")
    measure(running)
    running.supervisor.note_status(running.service.status().as_dict())
    assert "clouds/s" in running.manager.wait_for("STATUS", "points")


def test_without_a_trigger_and_paused_the_watchdog_is_fed(running: Running) -> None:
    assert running.fed()
    running.service.measure(False)
    assert running.fed()


def test_an_absent_camera_under_retry_is_an_idle_state(running: Running) -> None:
    measure(running)
    running.devices.cameras["left"].set_present(False)  # type: ignore[attr-defined]
    wait_until(lambda: running.service.cameras["left"].status.state == "lost")
    assert running.fed()


def test_a_pipeline_that_hangs_stops_the_watchdog_messages(running: Running, caplog: pytest.LogCaptureFixture) -> None:
    measure(running)
    hang(running)
    step(running.devices)
    assert running.hanging.wait(60)
    assert running.fed()  # it may take a while
    running.clock.advance(31.0)
    wait_until(lambda: not running.fed())
    wait_until(lambda: "the watchdog is not fed any more: the pipeline does not answer" in caplog.text)
    assert "EXTEND_TIMEOUT_USEC" not in [key for message in running.manager.read() for key in message]
    running.gate.set()
    wait_until(running.fed)
    wait_until(lambda: "the watchdog is fed again" in caplog.text)


def hang(running: Running) -> None:
    """Block the next measurement until the gate is opened."""
    made = running.service.worker._reconstructor
    assert made is not None
    reconstruct = made.reconstruct

    def hanging(*arguments: object, **options: object) -> object:
        running.hanging.set()
        running.gate.wait()
        return reconstruct(*arguments, **options)  # type: ignore[arg-type]

    made.reconstruct = hanging  # type: ignore[method-assign,assignment]


def test_a_camera_driver_that_hangs_stops_the_watchdog_messages(running: Running) -> None:
    measure(running)
    camera = running.service.cameras["right"]
    read = camera._camera.read

    def hanging(timeout_s: float) -> object:
        running.hanging.set()
        running.gate.wait()
        return read(timeout_s)

    camera._camera.read = hanging  # type: ignore[method-assign,assignment]
    assert running.hanging.wait(60)
    running.clock.advance(11.0)
    wait_until(lambda: not running.fed())
    running.supervisor.note_status(running.service.status().as_dict())
    assert "camera right" in running.manager.wait_for("STATUS", "not alive")


def test_a_sink_that_does_not_turn_stops_the_watchdog_messages(running: Running) -> None:
    from daemon.common.heartbeat import Heartbeat

    sink = running.service.router.sinks["stream"]
    sink.heartbeat = Heartbeat(running.clock.monotonic_ns)
    assert running.fed()
    sink.heartbeat.expect(-1.0)  # type: ignore[attr-defined]
    wait_until(lambda: not running.fed())


def test_a_reload_is_reported_from_its_beginning_to_its_end(running: Running) -> None:
    measure(running)
    wait_until(lambda: running.supervisor.ready)
    running.manager.read()
    assert running.supervisor.reload(lambda: running.manager.read()[-1]["RELOADING"]) == "1"
    assert running.manager.read()[-1]["READY"] == "1"


def test_without_a_manager_no_tick_is_registered(tmp_path: Path) -> None:
    service = Service(config(tmp_path), rig_of(devices()), {})
    Supervisor(Notifier()).watch(service)
    assert service.on_tick == []
