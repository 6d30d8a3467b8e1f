"""An installed service in a container: rigs for it, its status, and waiting for conditions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from fringed.control.client import ControlClient
from fringed.errors import ControlError
from tools.nspawn import Machine
from tools.nspawn.machine import WAIT_S
from tools.waiting import wait_until

SERVICE = "fringed.service"
RIG = "/etc/fringed/rig.yaml"
POLL_S = 0.05
"""Between two commands, or two requests to the daemon, as each takes processor time from the service."""
_SHOWN = "ActiveState", "SubState", "MainPID", "NRestarts", "StatusText", "Result"

MARKS = [pytest.mark.nspawn, pytest.mark.xdist_group("nspawn"), pytest.mark.slow, pytest.mark.timeout(600)]
"""Every wait in these tests has its own limit and reports the journal; the time-out is the last resort."""


def rig(**sections: Any) -> str:
    """Return rig.yaml of a small simulated rig of the service; None removes a section."""
    data: dict[str, Any] = {
        "device": {"name": "nspawn"},
        "cameras": {"driver": "sim"},
        "simulation": {"scene": "plane", "frames": 2, "rate_hz": 5.0, "layout": {"scale": 0.125}},
        "stream": {"endpoints": ["ipc:///run/fringed/stream", "tcp://127.0.0.1:5555"]},
        "control": {"endpoint": "ipc:///run/fringed/control"},
        "recording": {"dir": "/var/lib/fringed/takes", "min_free_mb": 1},
        "selfcheck": {"dir": "/var/lib/fringed/selfcheck"},
    }
    merged = {key: value for key, value in (data | sections).items() if value is not None}
    return yaml.safe_dump(merged, sort_keys=False)


class Fringed:
    """The installed service of a container."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    def write(self, path: str, text: str) -> None:
        """Write a file of the container in place, so that its owner and mode stay."""
        target = self.machine.root / path[1:]
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text)

    def configure(self, rig_yaml: str, drop_in: str = "") -> None:
        """Set another rig and other settings of the unit, from the next start on."""
        self.write(RIG, rig_yaml)
        self.write(f"/etc/systemd/system/{SERVICE}.d/test.conf", f"[Service]\n{drop_in}\n")
        self.machine.systemctl("daemon-reload")

    def start(self, rig_yaml: str, drop_in: str = "", *, wait: bool = True) -> None:
        """Restart with this rig."""
        self.stop()
        self.configure(rig_yaml, drop_in)
        self.machine.systemctl("start", "--no-block", SERVICE)
        if wait:
            self.wait_active()

    def stop(self) -> None:
        """Stop, and reset the failed state."""
        self.machine.systemctl("stop", SERVICE)
        self.machine.systemctl("reset-failed", SERVICE, check=False)

    def show(self) -> dict[str, str]:
        """Return its properties in systemd."""
        return self.machine.show(SERVICE, *_SHOWN)

    def wait(self, what: str, good: Callable[[dict[str, str]], bool]) -> dict[str, str]:
        """Return its properties in systemd once the condition holds."""
        return self.machine.wait_show(SERVICE, what, good, *_SHOWN)

    def wait_active(self, *, not_pid: str = "") -> dict[str, str]:
        """Wait until it is ready, as another process than this one."""
        return self.wait(
            "the service being ready",
            lambda shown: shown["ActiveState"] == "active" and shown["MainPID"] not in ("0", not_pid),
        )

    def status(self, timeout_s: float = 30.0) -> dict[str, Any]:
        """Return the daemon's own status."""
        with self.control(timeout_s) as client:
            answer: dict[str, Any] = client.call("status")
        return answer

    def control(self, timeout_s: float = 30.0) -> ControlClient:
        """Return a connection to its control socket."""
        return ControlClient(f"ipc://{self.machine.root}/run/fringed/control", timeout_s=timeout_s)

    def wait_status(self, what: str, good: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Return the daemon's status once it answers and the condition holds."""
        last: dict[str, Any] = {}

        def probe() -> bool:
            last.clear()
            try:
                last.update(self.status(5.0))
            except ControlError:
                return False
            return good(last)

        try:
            wait_until(probe, WAIT_S, what, poll_s=POLL_S)
        except Exception as error:
            raise AssertionError(f"{error}; status {last}\n{self.machine.tail(SERVICE)}") from None
        return last

    def wait_clouds(self, more: int = 2) -> dict[str, Any]:
        """Wait for this number of further clouds."""
        before = self.wait_status("an answer", bool)["clouds"]
        return self.wait_status(f"{more} more clouds", lambda status: status["clouds"] >= before + more)

    def pid_outside(self, pid: str | int) -> int:
        """Return the process id outside of a process of this container."""
        space = Path(f"/proc/{self.machine.leader}/ns/pid").readlink()
        for status in Path("/proc").glob("[0-9]*/status"):
            try:
                fields = status.read_text()
                ours = (status.parent / "ns/pid").readlink() == space
            except OSError:
                continue
            numbers = next((line.split()[1:] for line in fields.splitlines() if line.startswith("NSpid:")), [])
            if ours and numbers[-1:] == [str(pid)]:
                return int(numbers[0])
        raise AssertionError(f"no process {pid} in the container")

    def logged(self, text: str, since: str = "") -> bool:
        """Return whether a line of the service's journal has a text."""
        return any(text in str(line.get("MESSAGE", "")) for line in self.lines(since))

    def wait_logged(self, text: str, since: str, what: str) -> None:
        """Wait until a line of the service's journal after a cursor has a text."""
        wait_until(lambda: self.logged(text, since), WAIT_S, what, poll_s=POLL_S)

    def lines(self, since: str = "") -> list[dict[str, Any]]:
        """Return its journal after a cursor."""
        return self.machine.journal(SERVICE, *([f"--after-cursor={since}"] if since else []))

    def cursor(self) -> str:
        """Return the cursor at the end of its journal."""
        lines = self.lines()
        return str(lines[-1]["__CURSOR"]) if lines else ""
