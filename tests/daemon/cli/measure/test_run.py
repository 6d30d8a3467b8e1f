"""The command end to end: clouds reach a subscriber, a camera is lost and returns, the take is complete."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from mcap.reader import make_reader

from fringed import subscribe
from fringed.control.client import ControlClient
from fringed.errors import ControlError
from tools.waiting import wait_until

RIG = """
cameras: {{driver: sim}}
simulation:
  scene: plane
  frames: 2
  rate_hz: 20.0
  layout: {{scale: 0.125}}
  cache_dir: cache
  faults: {{script: [{{kind: gone, at: 60, side: right, length: 20}}]}}
stream: {{endpoints: ["ipc://{tmp}/s"]}}
control: {{endpoint: "ipc://{tmp}/c"}}
recording: {{min_free_mb: 10}}
"""
_FRINGED = "from daemon.cli.entry import main; main()"


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    (tmp_path / "rig.yaml").write_text(RIG.format(tmp=tmp_path))
    command = [sys.executable, "-c", _FRINGED, "run", str(tmp_path / "rig.yaml"), "--record", "first"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    yield process
    process.kill()
    process.communicate()


def state(client: ControlClient) -> str:
    try:
        return str(client.call("status")["state"])
    except ControlError:
        return "no answer"


def test_a_rig_is_measured_and_recorded_while_a_camera_is_lost_and_returns(
    daemon: subprocess.Popen[str], tmp_path: Path
) -> None:
    with ControlClient(f"ipc://{tmp_path}/c", timeout_s=1.0) as client:
        wait_until(lambda: state(client) in ("running", "degraded"), 90)
        with closing(subscribe(f"ipc://{tmp_path}/s", timeout_s=30)) as clouds:
            first = next(iter(clouds))
        assert first.header.device == "rig-01" and first.xyz.shape[-1] == 3 and len(first.points) > 1000
        wait_until(lambda: client.call("status")["cameras"]["right"]["losses"] == 1, 30)
        lost_at = client.call("status")["clouds"]
        wait_until(lambda: state(client) == "running" and client.call("status")["clouds"] > lost_at + 3, 30)
        status = client.call("status")
    daemon.send_signal(signal.SIGTERM)
    _, log = daemon.communicate(timeout=20)
    assert daemon.returncode == 0, log
    assert "degraded (camera right is gone" in log
    for camera in status["cameras"].values():
        assert abs(sum(camera["fates"].values()) - camera["frames"]) <= 1  # one frame may be in transit
    (take,) = (tmp_path / "takes").glob("first_*.mcap")
    with take.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count > 2 * status["recorder"]["pairs"]
    assert summary.statistics.attachment_count == 4
