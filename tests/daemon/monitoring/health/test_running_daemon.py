"""Health of a running simulated daemon: by control, on the stream, by the command, and as metrics."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fringed.control.client import ControlClient
from fringed.errors import ControlError
from tools.waiting import wait_until

RIG = """
cameras: {{driver: sim}}
simulation:
  scene: plane
  frames: 2
  rate_hz: 10.0
  layout: {{scale: 0.125}}
  cache_dir: cache
stream: {{endpoints: ["ipc://{tmp}/s"]}}
control: {{endpoint: "ipc://{tmp}/c"}}
selfcheck: {{enabled: false}}
health:
  metrics_port: 0
  window_s: 2
  raise_s: 1.0
  clear_s: 1.0
  # On a busy machine everything may be late; what is judged here is the room for takes alone.
  limits:
    least_disk_free_gb: {room}
    latency_p99_ms: null
    dropped_share: null
    lone_share: null
    refused_hz: null
    pairing_residual_us: null
    saturated_share: null
    least_modulation: null
    clock_offset_ms: null
"""
_FRINGED = "from daemon.cli.entry import main; main()"

Start = Callable[[float], Path]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts a daemon with this limit of free disk space; returns its directory."""
    started: list[subprocess.Popen[str]] = []

    def run(room_gb: float) -> Path:
        (tmp_path / "rig.yaml").write_text(RIG.format(tmp=tmp_path, room=room_gb))
        command = [sys.executable, "-c", _FRINGED, "run", str(tmp_path / "rig.yaml")]
        started.append(subprocess.Popen(command, stderr=subprocess.DEVNULL, text=True))
        return tmp_path

    yield run
    for process in started:
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0


def answer(client: ControlClient, method: str, **params: Any) -> Any:
    """The result of a method, None while there is no daemon yet."""
    try:
        return client.call(method, **params)
    except ControlError:
        return None


def verdict(client: ControlClient) -> str:
    return str(((answer(client, "status") or {}).get("health") or {}).get("verdict", ""))


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_daemon_reports_its_health(start: Start, fringed: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    directory = start(1e8)  # no disk has so much room
    with ControlClient(f"ipc://{directory}/c", timeout_s=30.0) as client:
        wait_until(lambda: verdict(client) == "warning", 90)
        status = client.call("status")
        assert "free for takes" in status["health"]["open"]["least_disk_free_gb"]
        assert not any("free for takes" in reason for reason in status["reasons"])
        wait_until(
            lambda: (answer(client, "health") or {"values": {}})["values"].get("modulation_left_red") is not None, 60
        )
        with urllib.request.urlopen(status["health"]["metrics"], timeout=30) as response:
            assert 'fringed_rule_open{rule="least_disk_free_gb"} 1' in response.read().decode()
    endpoint = ("--endpoint", f"ipc://{directory}/c", "--timeout", "30")
    done = fringed("health", *endpoint, "--png", str(directory / "h.png"), "--html", str(directory / "h.html"))
    assert done.returncode == 0 and done.stdout.startswith("WARNING"), done.stdout + done.stderr
    assert (directory / "h.png").read_bytes()[1:4] == b"PNG" and b"<svg" in (directory / "h.html").read_bytes()
    report = json.loads(fringed("health", *endpoint, "--json").stdout)
    assert report["verdict"] == "warning" and report["events"][-1]["rule"] == "least_disk_free_gb"


def test_without_a_daemon_the_exit_status_is_three(
    tmp_path: Path, fringed: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    done = fringed("health", "--endpoint", f"ipc://{tmp_path}/none", "--timeout", "0.2")
    assert done.returncode == 3 and "no daemon answers" in done.stderr
    done = fringed("health", "--endpoint", f"ipc://{tmp_path}/none", "--last", "soon")
    assert done.returncode == 2 and "15min" in done.stderr
