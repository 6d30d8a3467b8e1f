"""The daemon as a service manager runs it: one process, its messages, its signals, its exit status."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.bootstrap.systemd.manager import PATIENT, Manager
from tools.waiting import wait_until

pytestmark = PATIENT

RIG = """
cameras: {{driver: sim}}
simulation: {{scene: plane, frames: 2, rate_hz: 20.0, layout: {{scale: 0.125}}, cache_dir: cache}}
stream: {{endpoints: ["ipc://{tmp}/s"]}}
control: {{endpoint: "ipc://{tmp}/c"}}
"""
START = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG.format(tmp=tmp_path))
    return path


@pytest.fixture
def started(rig_file: Path, manager: Manager) -> Iterator[subprocess.Popen[str]]:
    with (rig_file.parent / "log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", START, "run", str(rig_file)],
            env=os.environ | manager.environment(watchdog_us=8_000_000),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            text=True,
        )
    yield process
    if process.poll() is None:
        process.kill()
        process.wait()


def test_ready_with_the_first_cloud_then_reloads_then_a_graceful_stop(
    started: subprocess.Popen[str], rig_file: Path, manager: Manager
) -> None:
    log = rig_file.parent / "log"
    manager.wait_for("READY", timeout_s=200)
    assert "60000000" in manager.values("EXTEND_TIMEOUT_USEC")
    manager.wait_for("WATCHDOG")
    assert "points" in manager.wait_for("STATUS", "clouds/s of")

    rig_file.write_text("cameras: {driver: smi}\n")
    ready = len(manager.values("READY"))
    started.send_signal(signal.SIGHUP)
    manager.wait_for("RELOADING")
    wait_until(lambda: len(manager.values("READY")) > ready)
    wait_until(lambda: "did you mean" in log.read_text())
    assert started.poll() is None

    started.send_signal(signal.SIGTERM)
    started.send_signal(signal.SIGHUP)  # while it stops: must not interrupt the stop
    assert started.wait(60) == 0
    assert manager.values("STOPPING") == ["1"]
    assert "Traceback" not in log.read_text()


@pytest.mark.parametrize(("supervised", "status"), [(True, 78), (False, 2)])
def test_an_invalid_rig_file_has_an_exit_status_of_its_own_for_a_manager(
    tmp_path: Path, manager: Manager, supervised: bool, status: int
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("cameras: {driver: sim}\npiepline: {}\n")
    done = subprocess.run(
        [sys.executable, "-c", START, "run", str(path)],
        env=os.environ | (manager.environment() if supervised else {}),
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == status
    assert f"{path}:2:1" in done.stderr
    assert manager.values("READY") == []
