"""A running daemon, reached from other machines with keys, its files closed to others."""

from __future__ import annotations

import json
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from daemon.cli.entry import run
from fringed.control.client import ControlClient
from fringed.errors import ControlError
from tests.daemon.remote_access import listening_addresses
from tools.waiting import wait_until

RIG = """
cameras: {{driver: sim}}
simulation: {{scene: plane, frames: 2, rate_hz: 5.0, layout: {{scale: 0.125}}, cache_dir: cache}}
stream:
  endpoints: ["ipc://{tmp}/run/s", "tcp://0.0.0.0:*"]
  allow_remote: true
control:
  endpoint: "ipc://{tmp}/run/c"
  remote: ["tcp://0.0.0.0:*"]
  allow_remote: true
security: {{keys: keys}}
recording: {{min_free_mb: 1}}
"""
_FRINGED = "import os; os.umask(0o022); from daemon.cli.entry import main; main()"
Fringed = Callable[..., subprocess.CompletedProcess[str]]
pytestmark = pytest.mark.timeout(600)


class Running:
    """A daemon with its keys, in a directory of its own."""

    def __init__(self, folder: Path, fringed: Fringed) -> None:
        self.folder, self.fringed = folder, fringed
        (folder / "rig.yaml").write_text(RIG.format(tmp=folder))
        for name, role in (("screen", "view"), ("boss", "operate")):
            assert run(["keys", "new", name, "--to", str(folder)]) == 0
            allow = ["keys", "allow", str(folder / f"{name}.pub"), "--control", role]
            assert run([*allow, "--rig", str(folder / "rig.yaml")]) == 0
        self.log = (folder / "log").open("w")
        command = [sys.executable, "-c", _FRINGED, "run", str(folder / "rig.yaml"), "--record", "first"]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=self.log, stderr=self.log)
        try:
            wait_until(self.measures, 400)
            self.stream, self.control = (self.port(service) for service in ("stream", "control"))
        except BaseException:
            self.process.kill()
            raise

    def status(self, timeout_s: float = 90.0) -> dict[str, Any]:
        with ControlClient(f"ipc://{self.folder}/run/c", timeout_s=timeout_s) as client:
            return dict(client.call("status"))

    def measures(self) -> bool:
        assert self.process.poll() is None, (self.folder / "log").read_text()
        try:
            return bool(self.status(5.0)["clouds"])
        except ControlError:
            return False

    def remote(self) -> dict[str, Any]:
        """The status of the remote access."""
        return dict(self.status()["sinks"]["remote"])

    def port(self, service: str) -> int:
        return int(self.remote()[service][0].rpartition(":")[2])

    def keys(self, *arguments: str) -> None:
        done = self.fringed("keys", *arguments, "--rig", str(self.folder / "rig.yaml"))
        assert done.returncode == 0, done.stderr

    def remotely(self, name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        """A command on another machine, with this key."""
        own = ["--key", str(self.folder / f"{name}.key"), "--server-key", str(self.folder / "keys" / "server.pub")]
        return self.fringed(*arguments, *own)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, fringed: Fringed) -> Iterator[Running]:
    made = Running(tmp_path_factory.mktemp("rig"), fringed)
    yield made
    made.process.kill()
    made.process.wait()
    made.log.close()


def test_a_remote_viewer_gets_the_status_and_the_clouds(running: Running) -> None:
    endpoint = f"tcp://127.0.0.1:{running.control}"
    done = running.remotely("screen", "status", "--endpoint", endpoint, "--json", "--timeout", "60")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["sinks"]["remote"]["keys"] == 2
    heard = running.remotely("screen", "listen", f"tcp://127.0.0.1:{running.stream}", "--count", "2", "--seconds", "60")
    assert heard.returncode == 0, heard.stderr


def test_it_may_not_operate_and_the_status_counts_the_attempt(running: Running) -> None:
    endpoint = f"tcp://127.0.0.1:{running.control}"
    before = running.status()["recorder"]
    refused = running.remotely("screen", "record", "stop", "--endpoint", endpoint)
    assert refused.returncode == 1 and "may only view" in refused.stderr
    assert running.status()["recorder"]["recording"] == before["recording"] is True
    wait_until(lambda: running.remote()["refused"].get("control_role"))
    paused = running.remotely("boss", "stop", "--endpoint", endpoint, "--timeout", "60")
    assert paused.returncode == 0 and "paused" in paused.stdout, paused.stderr
    assert running.remotely("boss", "start", "--endpoint", endpoint, "--timeout", "60").returncode == 0


def test_it_listens_at_the_addresses_of_rig_yaml_only(running: Running) -> None:
    assert listening_addresses.addresses(running.process.pid) == {
        ("0.0.0.0", running.stream),
        ("0.0.0.0", running.control),
    }


def test_its_files_are_closed_to_others(running: Running) -> None:
    wait_until(lambda: any((running.folder / "takes").glob("first*")))
    made = [path for path in running.folder.rglob("*") if path.parent != running.folder or path.name == "takes"]
    assert len(made) > 5
    modes: dict[Path, int] = {}
    for path in made:
        if path.name != "server.pub" and not path.is_socket():
            with suppress(FileNotFoundError):  # one that was only there while another was written
                modes[path] = stat.S_IMODE(path.stat().st_mode)
    for path, mode in modes.items():
        assert not mode & (stat.S_IRWXO | stat.S_IWGRP), f"{path} has mode {mode:o}"
    for name in ("s", "c"):
        assert stat.S_IMODE((running.folder / "run" / name).stat().st_mode) == 0o660
    assert stat.S_IMODE((running.folder / "run").stat().st_mode) == 0o700


@pytest.mark.last
def test_a_key_is_revoked_while_it_runs_and_a_stop_is_clean(running: Running) -> None:
    running.keys("revoke", "screen")
    wait_until(lambda: running.remote()["cut"].get("control_revoked"))
    endpoint = f"tcp://127.0.0.1:{running.control}"
    refused = running.remotely("screen", "status", "--endpoint", endpoint, "--timeout", "2")
    assert refused.returncode == 2 and "does it allow this key" in refused.stderr
    family = listening_addresses.family(running.process.pid)
    running.process.send_signal(signal.SIGTERM)
    running.process.wait(90)
    log = (running.folder / "log").read_text()
    assert running.process.returncode == 0 and "started again" not in log, log
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in family))


def test_a_missing_key_is_reported_with_the_line_of_the_file(tmp_path: Path, fringed: Fringed) -> None:
    (tmp_path / "rig.yaml").write_text(RIG.format(tmp=tmp_path))
    done = fringed("run", str(tmp_path / "rig.yaml"))
    assert done.returncode == 2 and "rig.yaml:11:18: security.keys" in done.stderr and "keys server" in done.stderr
