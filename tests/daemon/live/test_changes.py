"""Changes of a running daemon: all of it between two pairs, or nothing."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import pytest
import yaml

from daemon.common.errors import DaemonError
from daemon.control.calibrate_methods import CalibrateMethods
from daemon.control.methods import Methods
from daemon.control.rpc.protocol import FAILED, INVALID_PARAMS, RpcError
from daemon.control.sequence_capture import Capture
from daemon.control.settings.live_settings import LIVE
from daemon.live.status import State
from pipeline.pattern import color_fringe
from pipeline.pattern.color_fringe import ColorFringe
from tests.daemon.running_daemon import Running, warmed
from tools.waiting import wait_until


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    made = warmed(tmp_path_factory.mktemp("rig"))
    yield made
    made.stop()


@pytest.fixture
def running(daemon: Running) -> Running:
    """The rig of its file."""
    daemon.sink.refusal = ""
    daemon.write_calibration(daemon.devices.calibration)
    daemon.write()
    daemon.call("reload")
    return daemon


def refused(running: Running, method: str, /, **params: object) -> RpcError:
    """The refusal of a call that must change nothing."""
    before = running.as_it_is()
    with pytest.raises(RpcError) as caught:
        running.call(method, **params)
    assert running.as_it_is() == before
    return caught.value


def committed(running: Running) -> Any:
    """The configuration that the sinks have: the one of the start until something changes."""
    found = running.sink.committed
    return found[-1][0] if found else running.service.config


@pytest.mark.parametrize(
    ("path", "value", "read"),
    [
        ("pipeline.settings.min_modulation", 7, lambda r: r.service.settings.min_modulation),
        ("pipeline.overload", "half", lambda r: r.service.worker._config.overload),
        ("pipeline.temporal_prior", False, lambda r: r.service.worker._config.temporal_prior),
        ("pairing.tolerance_us", 1500, lambda r: r.service.pairer._pairer.settings.tolerance_ns / 1000),
        ("pairing.resync_after", 5, lambda r: r.service.pairer._pairer.settings.resync_after),
        ("recording.min_free_mb", 17, lambda r: r.recorder._config.recording.min_free_mb),
        ("stream.preview_hz", 0.5, lambda r: committed(r).stream.preview_hz),
        ("selfcheck.limits.column_px", 0.5, lambda r: committed(r).selfcheck.limits.column_px),
        ("volume", {"near_mm": 1100, "far_mm": 1400}, lambda r: asdict(r.service.rig.volume)),
    ],
)
def test_a_live_setting_is_taken_over_and_read_back(
    running: Running, path: str, value: object, read: Callable[[Running], object]
) -> None:
    """``read`` finds it in the part that uses it."""
    assert read(running) != value
    assert running.call("set", path=path, value=value) == {path: value}
    assert read(running) == value and running.call("get", path=path) == value
    running.clouds(2)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("pipeline.settings.min_modulation", 1e9),
        ("pipeline.settings.min_modulation", "7"),
        ("pipeline.settings.min_modulation", None),
        ("pipeline.settings.min_modulation", {"a": [1]}),
        ("pipeline.settings.nothing", 1),
        ("pipeline.settings", {}),
        ("pipeline.overload", "all"),
        ("pairing.tolerance_us", -1),
        ("pairing.tolerance_us", True),
        ("stream.preview_hz", 1e400),
        ("volume", {"near_mm": 5, "far_mm": 4}),
        ("recording.dir", "/etc"),
        ("calibration", "other.yaml"),
        ("volume", "/etc/passwd"),
        ("device.name", "x"),
        ("control.endpoint", "ipc:///tmp/x"),
        ("cameras.left.exposure_us", 5),
        ("__class__", 1),
        ("", 1),
    ],
)
def test_what_cannot_be_set_is_rejected_with_its_path_and_changes_nothing(
    running: Running, path: str, value: object
) -> None:
    error = refused(running, "set", path=path, value=value)
    assert (error.code, error.path) == (INVALID_PARAMS, path)


def test_what_was_set_live_goes_back_to_the_file_with_a_reload(running: Running) -> None:
    running.call("set", path="pairing.max_wait_ms", value=321)
    assert running.call("reload")["changed"] == ["pairing.max_wait_ms"]
    assert running.service.config.pairing.max_wait_ms == 500
    assert running.call("reload") == {"changed": [], "restart": []}


def test_a_good_file_changes_everything_at_once(running: Running) -> None:
    running.write("pairing: {max_wait_ms: 250}\npipeline: {settings: {min_modulation: 9.0}}\n", near=1250)
    before = len(running.sink.committed)
    assert running.call("reload")["changed"] == ["volume", "pairing.max_wait_ms", "pipeline.settings.min_modulation"]
    assert running.service.rig.volume.near_mm == 1250 and running.service.settings.min_modulation == 9
    assert len(running.sink.committed) == before + 1
    running.clouds(1)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("device: {name: other}\npairing: {max_wait_ms: 250}\n", "device.name needs a restart"),
        ("pairing: {max_wait_ms: -1}\n", r"rig\.yaml:6:"),
        ("pipeline: {settings: {min_modulation: 1e9}}\n", "min_modulation"),
        ("cameras: {driver: sim}\n", "twice"),
        ("\x00", "YAML"),
    ],
)
def test_a_file_that_cannot_be_taken_over_changes_nothing(running: Running, more: str, message: str) -> None:
    running.write(more)
    error = refused(running, "reload")
    assert error.code == FAILED and re.search(message, error.message)


def test_what_needs_a_restart_is_listed_by_path(running: Running) -> None:
    running.write("device: {name: other}\npairing: {max_wait_ms: 250}\npipeline: {threads: 1}\n")
    error = refused(running, "reload")
    assert error.as_object()["data"] == {
        "changed": [],
        "restart": ["device.name", "pipeline.threads"],
        "live": ["pairing.max_wait_ms"],
        "path": "device.name",
    }


def test_another_calibration_is_taken_over_between_two_pairs(running: Running) -> None:
    data = dict(running.devices.calibration) | {"quality": {"made": "again"}}
    old = running.service.rig.identity
    running.write_calibration(data)
    assert running.call("reload")["changed"] == ["calibration"]
    assert running.service.rig.identity != old
    assert running.sink.committed[-1][1] is running.service.rig
    running.clouds(2)


def test_a_set_does_not_read_other_files_again(running: Running) -> None:
    old = running.service.rig.identity
    (running.path / "calibration.yaml").write_text("no calibration")
    running.call("set", path="volume", value={"near_mm": 1000, "far_mm": 1400})
    assert running.service.rig.identity == old and running.service.rig.volume.near_mm == 1000


def test_a_calibration_that_cannot_be_used_changes_nothing(running: Running) -> None:
    (running.path / "calibration.yaml").write_text("fringed_calibration: 1\n")
    assert "calibration.yaml" in refused(running, "reload").message
    (running.path / "calibration.yaml").unlink()
    assert "calibration.yaml" in refused(running, "reload").message


def test_a_calibration_of_other_cameras_changes_nothing(running: Running) -> None:
    data = yaml.safe_load(yaml.safe_dump(dict(running.devices.calibration)))
    left = data["cameras"]["left"]
    left["size"] = width, height = [value // 2 for value in left["size"]]
    left["matrix"][:2] = [[value / 2 for value in row] for row in left["matrix"][:2]]
    running.write_calibration(data)
    assert f"{width} x {height}" in refused(running, "reload").message


def test_takes_go_to_another_directory_after_a_reload(running: Running) -> None:
    running.write("recording: {dir: elsewhere}\n")
    assert running.call("reload")["changed"] == ["recording.dir"]
    assert "elsewhere" in running.call("snapshot")["file"]


def test_another_projected_image_needs_a_restart(running: Running) -> None:
    other = ColorFringe(size=running.service.rig.pattern.size, periods=7)
    running.service.path.rig = replace(running.service.rig, pattern=other)
    try:
        running.write(f"pattern: {dict(running.devices.pattern)}\n")
        assert "pattern" in refused(running, "reload").as_object()["data"]["restart"]
    finally:
        running.service.path.rig = replace(
            running.service.rig, pattern=color_fringe.from_mapping(running.devices.pattern)
        )


def test_a_sink_that_rejects_a_change_keeps_everything_as_it_was(running: Running) -> None:
    running.sink.refusal = "the disk is elsewhere"
    assert "elsewhere" in refused(running, "set", path="pairing.max_wait_ms", value=20).message


def test_a_reconstructor_that_cannot_be_made_keeps_everything_as_it_was(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise DaemonError("it cannot be made")

    monkeypatch.setattr(running.service.path, "_reconstructor", fail)
    running.write("pairing: {tolerance_us: 1500}\npipeline: {overload: half, temporal_prior: false}\n", near=1250)
    assert "it cannot be made" in refused(running, "reload").message
    running.clouds(1)


def test_no_reload_while_a_take_is_written(running: Running) -> None:
    running.call("record.start", name="a")
    try:
        assert "take" in refused(running, "reload").message
    finally:
        running.call("record.stop")


def test_no_reload_while_images_are_captured(running: Running) -> None:
    class Busy:
        active = True

    calibrate = CalibrateMethods(running.service, cast(Capture, Busy()))
    methods = Methods(
        running.service, running.recorder, path=running.rig_file, base_dir=running.path, calibrate=calibrate
    ).table()
    running.write("pairing: {max_wait_ms: 250}\n")
    with pytest.raises(RpcError, match="capture"):
        methods["reload"]({})
    assert running.service.config.pairing.max_wait_ms == 500


def test_every_setting_is_listed_with_its_meaning(running: Running) -> None:
    rows = {row["path"]: row for row in running.call("get")["settings"]}
    assert all(row["doc"] and row["type"] for row in rows.values())
    row = rows["pairing.tolerance_us"]
    assert (row["unit"], row["above"], row["max"], row["value"], row["live"]) == ("µs", 0, 1e6, 2000.0, True)
    row = rows["pipeline.settings.min_modulation"]
    assert (row["min"], row["max"], row["unit"], row["live"]) == (0.5, 100, "counts", True)
    assert rows["pipeline.overload"]["choices"] == ["skip", "half"] and not rows["device.name"]["live"]
    assert [row["path"] for row in running.call("get", path="device", detail=True)["settings"]] == ["device.name"]


def test_every_live_setting_exists(running: Running) -> None:
    paths = [row["path"] for row in running.call("get")["settings"]]
    for entry in LIVE:
        assert any(f"{path}.".startswith(entry.removesuffix("*").rstrip(".") + ".") for path in paths), entry


def test_a_section_is_reported_as_in_the_file(running: Running) -> None:
    assert running.call("get", path="pairing") == {"tolerance_us": 2000.0, "max_wait_ms": 500.0, "resync_after": 3}
    assert running.call("get", path="selfcheck")["limits"]["column_px"] == 0.04


def test_a_pause_that_comes_while_a_capture_ends_is_not_lost(running: Running) -> None:
    service = running.service
    for _ in range(200):
        service.divert(lambda _: None)
        ends = threading.Thread(target=service.divert, args=(None,))
        ends.start()
        service.measure(False)
        ends.join()
        assert service.state()[0] is State.PAUSED and not service.cameras["left"]._enabled.is_set()
        service.measure(True)


def test_a_change_that_waits_when_the_daemon_stops_fails_at_once(tmp_path: Path) -> None:
    running = Running(tmp_path)
    held, go = threading.Event(), threading.Event()
    failures: list[str] = []

    def hold() -> None:
        held.set()
        assert go.wait(60)

    def change() -> None:
        try:
            running.call("set", path="pairing.max_wait_ms", value=77)
        except RpcError as error:
            failures.append(error.message)

    def keep() -> None:
        # Applied or refused, by whether the worker or the stop comes first.
        with suppress(DaemonError):
            running.service.worker.replace(hold, 60)

    holding = threading.Thread(target=keep)
    holding.start()
    assert held.wait(30)
    waiting = threading.Thread(target=change)
    waiting.start()
    wait_until(lambda: len(running.service.worker._changes) == 1)
    running.service.request_stop()
    waiting.join(60)  # a change that is never applied fails with another message after 20 s
    assert failures == ["the daemon is stopping; nothing was changed"]
    go.set()
    holding.join(30)
    running.thread.join(60)
    assert not running.thread.is_alive() and running.service.config.pairing.max_wait_ms == 500
