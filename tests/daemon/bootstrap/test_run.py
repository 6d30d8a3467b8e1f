"""Putting a daemon together: signals at any moment, and mistakes that leave nothing behind."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from typing import Any

import pytest

from daemon.bootstrap import run
from daemon.bootstrap.run import StopFlag
from daemon.common.errors import ConfigError, DaemonError
from fringed.control.client import ControlClient
from tests.daemon.rigs import Collector
from tools.waiting import wait_until

RIG = """
cameras: {{driver: sim}}
simulation: {{scene: plane, frames: 2, rate_hz: 20.0, layout: {{scale: 0.125}}, cache_dir: cache{more}}}
stream: {{endpoints: ["ipc://{tmp}/s"]}}
control: {{endpoint: "ipc://{tmp}/c"}}
"""


class Stream(Collector):
    def __init__(self) -> None:
        super().__init__()
        self.statuses: list[dict[str, Any]] = []

    def publish_status(self, status: dict[str, Any]) -> None:
        self.statuses.append(status)


@pytest.fixture
def stream(monkeypatch: pytest.MonkeyPatch) -> Stream:
    made = Stream()
    monkeypatch.setattr(run, "open_publisher", lambda *_: made)
    return made


def rig_file(tmp_path: Path, more: str = "") -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG.format(tmp=tmp_path, more=more))
    return path


def test_a_simulated_rig_is_rendered_measured_and_stopped_by_a_signal(tmp_path: Path, stream: Stream) -> None:
    calls: list[tuple[int, int]] = []

    def watch() -> None:
        wait_until(lambda: len(stream.clouds) >= 3, 90)
        with ControlClient(f"ipc://{tmp_path}/c") as client:
            assert client.call("status")["state"] == "running"
        os.kill(os.getpid(), signal.SIGTERM)

    watcher = threading.Thread(target=watch)
    with StopFlag().on_signals() as flag:
        watcher.start()
        run.run_rig(rig_file(tmp_path), flag=flag, progress=lambda done, of: calls.append((done, of)))
    watcher.join()
    assert calls[-1] == (2, 2) and stream.closed
    assert stream.statuses[-1]["state"] == "stopping"
    assert not (tmp_path / "c").exists()


def test_a_signal_while_the_rig_is_rendered_ends_it_there(tmp_path: Path, stream: Stream) -> None:
    with StopFlag().on_signals() as flag:
        run.run_rig(rig_file(tmp_path), flag=flag, progress=lambda *_: os.kill(os.getpid(), signal.SIGINT))
    assert not stream.items and not stream.statuses


def test_an_unknown_option_of_the_simulation_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"rig\.yaml:3:\d+: simulation\.farmes is not an option"):
        run.run_rig(rig_file(tmp_path, ", farmes: 3"))


def test_a_take_that_cannot_begin_is_reported_and_everything_is_closed(tmp_path: Path, stream: Stream) -> None:
    (tmp_path / "takes").write_text("no directory")
    with pytest.raises(DaemonError, match="takes: cannot be created"):
        run.run_rig(rig_file(tmp_path), record="x")
    assert stream.closed and not (tmp_path / "c").exists()


def test_an_address_in_use_is_reported_and_everything_is_closed(tmp_path: Path, stream: Stream) -> None:
    path = rig_file(tmp_path)
    path.write_text(path.read_text().replace(f"ipc://{tmp_path}/c", f"ipc://{tmp_path}/no/such/{'x' * 20}"))
    (tmp_path / "no").write_text("a file where a directory should be")
    with pytest.raises((DaemonError, OSError)):
        run.run_rig(path)
    assert stream.closed
