"""The daemon end to end on a small stepped rig: clouds flow, losses are named, the end is orderly."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from daemon.bootstrap.systemd.status_line import loading
from daemon.common.errors import DaemonError
from daemon.kernels.processes import Progress
from daemon.live import frame_path
from daemon.live.items import Item
from daemon.live.service import Service
from daemon.live.status import State
from daemon.recording.recorder import Recorder
from sim.devices.open_rig import RigDevices
from sim.rig.layout import RigLayout
from tests.daemon.rigs import Collector, config, devices, rig_of, step
from tools.waiting import wait_until


@dataclass
class Running:
    service: Service
    devices: RigDevices
    sink: Collector
    statuses: list[dict[str, Any]]
    thread: threading.Thread

    def step(self, count: int = 1) -> None:
        """Give triggers; the queues are wide enough for those of a test."""
        for _ in range(count):
            step(self.devices)

    def state(self) -> State:
        return self.service.state()[0]

    def stop(self) -> None:
        self.service.request_stop()
        self.thread.join(20)
        assert not self.thread.is_alive()


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    made = devices()
    sink, statuses = Collector(), []
    wide = config(tmp_path, "pipeline: {queue: 16}\n")
    service = Service(wide, rig_of(made), {"stream": sink}, on_status=statuses.append)
    thread = threading.Thread(target=service.run, daemon=True)
    running = Running(service, made, sink, statuses, thread)
    thread.start()
    wait_until(lambda: running.state() is State.RUNNING, 60)
    wait_until(lambda: all(c["state"] == "acquiring" for c in service.status().as_dict()["cameras"].values()))
    yield running
    running.stop()


def test_every_pair_becomes_a_cloud_and_is_offered_raw_before(running: Running) -> None:
    running.step(6)
    wait_until(lambda: len(running.sink.clouds) == 6)
    assert [item.seq for item in running.sink.clouds] == list(range(6))
    assert [item.left.trigger for item in running.sink.pairs] == list(range(6))
    status = running.service.status()
    assert status.pairs == status.clouds == 6 and status.drops == status.drops_starting == {}
    assert set(status.processors) == {"share", "lost_s"}
    assert status.cameras["left"].fates["paired"] == 6
    assert set(status.latency_ms) == {"p50", "p95", "p99", "p999", "max", "last"}
    assert status.publish_latency_ms == {} and status.measured_every == 1
    assert set(status.garbage) == {"count", "total_ms", "max_ms"}
    assert status.slowest["latency_ms"] == pytest.approx(status.latency_ms["max"], abs=0.01)
    faults = status.memory
    assert faults["minor_faults"] + faults["major_faults"] >= faults["pair_worst"] >= faults["pair_p50"] >= 0


def test_a_camera_that_goes_away_degrades_the_daemon_and_comes_back_by_itself(running: Running) -> None:
    running.step(4)
    running.devices.cameras["right"].set_present(False)  # type: ignore[attr-defined]
    wait_until(lambda: running.state() is State.DEGRADED)
    status = running.service.status()
    assert "camera right is gone" in status.reasons[0] and status.cameras["right"].losses == 1
    running.devices.cameras["right"].set_present(True)  # type: ignore[attr-defined]
    wait_until(lambda: running.state() is State.RUNNING)
    wait_until(lambda: running.service.cameras["right"].status.state == "acquiring")
    back = running.service.status().cameras["right"]
    assert back.problem == "" and back.losses == 1
    before = running.service.worker.clouds
    running.step(4)
    wait_until(lambda: running.service.worker.clouds == before + 4)


def test_a_layout_that_cannot_distinguish_orders_is_a_warning_in_the_mode_single(tmp_path: Path) -> None:
    rig = rig_of(devices())
    middle = replace(rig, calibration=RigLayout(projector_fraction=0.5).calibration())
    for used, mode, expected in ((rig, "single", False), (middle, "single", True), (middle, "gray", False)):
        service = Service(config(tmp_path, f"mode: {mode}\n"), used, {})
        assert any("fringe" in warning for warning in service.status().warnings) == expected


def test_a_full_sink_loses_its_items_by_name_and_nobody_else_waits(running: Running) -> None:
    running.service.router.add_sink("slow", Collector(full=True))
    running.step(4)
    wait_until(lambda: len(running.sink.clouds) == 4)
    wait_until(lambda: running.service.drops["clouds_slow_busy"] == 4)
    assert running.service.drops["pairs_slow_busy"] == 4


def test_a_sink_that_breaks_is_counted_and_harms_nobody(running: Running) -> None:
    class Broken(Collector):
        def offer(self, item: Item) -> bool:  # noqa: ARG002 - the protocol's
            raise RuntimeError("broken")

    running.service.router.add_sink("bad", Broken())
    running.step(4)
    wait_until(lambda: len(running.sink.clouds) == 4)
    wait_until(lambda: running.service.drops["clouds_bad_failed"] == 4)
    assert running.state() is State.RUNNING


def test_a_setting_that_changes_is_used_from_the_next_pair_on(running: Running) -> None:
    running.step(4)
    wait_until(lambda: len(running.sink.clouds) == 4)
    service = running.service
    service.change(service.config, service.rig, service.settings.with_overrides({"min_modulation": 100.0}), ())
    running.step(1)
    wait_until(lambda: len(running.sink.clouds) == 5)
    assert running.sink.clouds[-1].cloud.points == 0


def test_a_sink_with_a_problem_degrades_the_daemon(running: Running) -> None:
    running.sink.problem = "no space left"
    assert running.service.state() == (State.DEGRADED, ("stream: no space left",))


def test_pausing_stops_frames_and_starting_brings_them_back(running: Running) -> None:
    running.service.measure(False)
    assert running.state() is State.PAUSED
    wait_until(lambda: all(c.status.state == "paused" for c in running.service.cameras.values()))
    running.step()
    assert running.service.status().pairs == 0
    running.service.measure(True)
    wait_until(lambda: all(c.status.state == "acquiring" for c in running.service.cameras.values()))
    running.step(4)
    wait_until(lambda: len(running.sink.clouds) == 4)


def test_stopping_closes_sinks_and_devices_and_reports_the_state(running: Running) -> None:
    running.step(1)
    running.stop()
    assert running.sink.closed
    assert {str(camera.state) for camera in running.devices.cameras.values()} == {"closed"}  # type: ignore[attr-defined]
    assert running.statuses[-1]["state"] == "stopping"
    assert sum(running.service.pairer.outcomes("left").values()) == running.service.cameras["left"].status.frames


def test_stopping_while_starting_is_orderly(tmp_path: Path) -> None:
    made, sink = devices(), Collector()
    service = Service(config(tmp_path), rig_of(made), {"stream": sink})
    service.request_stop()
    service.run()
    assert sink.closed


def test_nothing_is_measured_with_other_cameras_than_the_calibrated_ones(tmp_path: Path) -> None:
    rig = replace(rig_of(devices()), serials={"left": "sim-right", "right": "sim-left"})
    sink, failures = Collector(), []
    service = Service(config(tmp_path), rig, {"stream": sink})

    def run() -> None:
        try:
            service.run()
        except DaemonError as error:
            failures.append(str(error))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    wait_until(lambda: service.ready or not thread.is_alive(), 60)
    service.request_stop()
    thread.join(20)
    assert len(failures) == 1 and failures[0].startswith("the cameras are exchanged")
    assert sink.closed and not sink.items


def test_stopping_ends_a_compilation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: Any) -> None:
    def compile_for_ever(_jobs: object, notify: Callable[[Progress], None]) -> None:
        while True:
            notify(Progress(3, 9))
            time.sleep(0.01)

    monkeypatch.setattr(frame_path, "compile_kernels", compile_for_ever)
    service = Service(config(tmp_path), rig_of(devices()), {"stream": Collector()})
    thread = threading.Thread(target=service.run, daemon=True)
    thread.start()
    wait_until(lambda: service.status().kernels == {"ready": 3, "total": 9}, 30)
    assert loading(service.status().as_dict()) == "starting: compiling kernels, 3 of 9"
    service.request_stop()
    thread.join(20)
    assert not thread.is_alive()
    assert not any("left behind" in record.getMessage() for record in caplog.records)


def test_held_cameras_take_no_trigger_before_the_kernels_are_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiling, go = threading.Event(), threading.Event()

    def compile_later(_jobs: object, _notify: object) -> None:
        compiling.set()
        assert go.wait(30)

    monkeypatch.setattr(frame_path, "compile_kernels", compile_later)
    made, sink = devices(), Collector()
    service = Service(config(tmp_path, "pipeline: {queue: 16}\n"), rig_of(made), {"stream": sink}, hold_cameras=True)
    thread = threading.Thread(target=service.run, daemon=True)
    thread.start()
    assert compiling.wait(30)
    for _ in range(3):
        step(made)
    assert {camera.status.state for camera in service.cameras.values()} == {"paused"}
    go.set()
    wait_until(lambda: all(camera.status.state == "acquiring" for camera in service.cameras.values()), 30)
    for _ in range(4):
        step(made)
    wait_until(lambda: len(sink.clouds) == 4)
    status = service.status()
    assert status.pairs == 4 and status.drops == status.drops_starting == {}
    service.request_stop()
    thread.join(20)
    assert not thread.is_alive()


def test_a_take_is_a_sink_for_as_long_as_it_lasts(running: Running, tmp_path: Path) -> None:
    taken = Collector()
    recorder = Recorder(
        running.service.router, running.service.config, tmp_path / "takes", lambda _: taken, clock=running.service.clock
    )
    assert recorder.start("a")["recording"] is True
    with pytest.raises(DaemonError, match="already"):
        recorder.start("b")
    running.step(4)
    wait_until(lambda: len(taken.pairs) == 4)
    assert recorder.stop()["file"].startswith(str(tmp_path / "takes" / "a_")) and taken.closed
    assert recorder.stop() == {"recording": False}
