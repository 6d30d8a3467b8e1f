"""The RPC methods of a running daemon, and what they refuse."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from daemon.control.methods import Methods
from daemon.control.rpc.protocol import RpcError
from daemon.live.service import Service
from daemon.live.status import State
from daemon.recording.recorder import Recorder
from tests.daemon.rigs import Collector, config, devices, rig_of, step
from tools.waiting import wait_until

RIG = "cameras: {{driver: sim}}\npipeline: {{settings: {{min_modulation: {0}}}}}\n{1}"


@pytest.fixture(scope="module")
def methods(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Methods]:
    tmp_path = tmp_path_factory.mktemp("rig")
    made = devices()
    service = Service(config(tmp_path), rig_of(made), {"stream": Collector()})
    recorder = Recorder(service.router, service.config, tmp_path / "takes", lambda _: Collector(), clock=service.clock)
    thread = threading.Thread(target=service.run)
    thread.start()
    wait_until(lambda: service.state()[0] is State.RUNNING, 60)
    wait_until(lambda: all(camera.status.state == "acquiring" for camera in service.cameras.values()))
    for _ in range(4):
        step(made)
    wait_until(lambda: service.worker.last is not None)
    yield Methods(service, recorder, path=tmp_path / "rig.yaml", base_dir=tmp_path)
    service.request_stop()
    thread.join(20)


def call(methods: Methods, method: str, /, **params: object) -> object:
    return methods.table()[method](params)


def test_hello_identifies_the_daemon(methods: Methods) -> None:
    hello = methods.hello({})
    assert hello["program"] == "fringed" and hello["device"] == "rig-01" and "status" in hello["methods"]


def test_a_setting_is_set_from_the_next_pair_on_and_read_back(methods: Methods) -> None:
    assert call(methods, "set", path="pipeline.settings.min_modulation", value=7.0) == {
        "pipeline.settings.min_modulation": 7.0
    }
    assert call(methods, "get", path="pipeline.settings.min_modulation") == 7.0


def test_a_setting_is_found_by_its_former_name(methods: Methods) -> None:
    former, present = "pipeline.settings.min_component", "pipeline.settings.cluster_min_area"
    assert call(methods, "set", path=former, value=90) == {present: 90}
    assert call(methods, "get", path=former) == call(methods, "get", path=present) == 90


@pytest.mark.parametrize(
    ("path", "value"),
    [("pipeline.settings.min_modulation", 1e9), ("pipeline.settings.nothing", 1), ("device.name", "x"), ("", 1)],
)
def test_what_cannot_be_set_is_refused_with_its_path(methods: Methods, path: str, value: object) -> None:
    with pytest.raises(RpcError) as caught:
        call(methods, "set", path=path, value=value)
    assert caught.value.path == path


def test_get_refuses_unknown_settings(methods: Methods) -> None:
    with pytest.raises(RpcError, match="no setting"):
        call(methods, "get", path="pipeline.nothing.deeper")


def test_a_snapshot_is_the_newest_cloud_in_the_directory_of_takes(methods: Methods) -> None:
    answer = call(methods, "snapshot", name="bench")
    assert isinstance(answer, dict)
    path = Path(answer["file"])
    assert path.parent.name == "takes" and path.name.startswith("bench_")
    with np.load(path) as file:
        assert sorted(file) == ["gray", "sigma_mm", "xyz"]


@pytest.mark.parametrize("name", ["../x", "/etc/x", "", ".x", "a/b", "x" * 65, "a\0b", 5])
@pytest.mark.parametrize("method", ["snapshot", "record.start"])
def test_a_name_cannot_leave_the_directory(methods: Methods, method: str, name: object) -> None:
    with pytest.raises(RpcError):
        call(methods, method, name=name)


def test_unknown_parameters_are_refused(methods: Methods) -> None:
    with pytest.raises(RpcError, match="unknown parameter 'nam'"):
        call(methods, "snapshot", nam="x")


def test_a_take_begins_once_and_ends(methods: Methods) -> None:
    assert call(methods, "record.start", name="a")["recording"] is True  # type: ignore[index]
    with pytest.raises(RpcError, match="already"):
        call(methods, "record.start", name="b")
    assert call(methods, "record.stop")["recording"] is False  # type: ignore[index]


def test_patterns_are_shown_by_name(methods: Methods) -> None:
    assert call(methods, "pattern.show", name="black") == {"shown": "black"}
    assert call(methods, "pattern.show") == {"shown": "fringe"}
    with pytest.raises(RpcError, match="no image"):
        call(methods, "pattern.show", name="plaid")
    with pytest.raises(RpcError, match="simulated"):
        call(methods, "pattern.show", name="white")


def test_measuring_stops_and_starts(methods: Methods) -> None:
    assert call(methods, "stop") == {"state": "paused"}
    assert call(methods, "start") == {"state": "running"}


def test_the_status_is_plain_json(methods: Methods) -> None:
    import json

    from daemon.cli.control.status_rows import table

    status = json.loads(json.dumps(call(methods, "status")))
    assert status["state"] == "running" and "camera left" in table(status)
