"""One booted container: commands inside, properties of units, waiting for conditions, the journal."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from tools.nspawn.boot import CHECKOUT, VENV
from tools.waiting import wait_until

WAIT_S = 90.0
"""Longest wait for a condition on a busy machine, seconds."""
_POLL_S = 0.05
_NEEDED = ("systemd-nspawn", "nsenter", "unshare", "setpriv", "mount")
_ENVIRONMENT = {
    "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    "LANG": "C.UTF-8",
    "HOME": "/root",
}


class MachineError(RuntimeError):
    """The container does not start, or a wait timed out; the message ends with the output."""


def missing() -> str:
    """Return why no container can be started here; empty if one can."""
    if os.geteuid() != 0:
        return "a container of systemd needs root"
    gone = [name for name in _NEEDED if shutil.which(name) is None]
    return f"missing: {', '.join(gone)}; install with: tools/system-packages systemd" if gone else ""


class Machine:
    """A container with systemd as its first process; for ``with``.

    It ends with this process, in any case: its processes live in a process namespace whose first one the kernel kills,
    its mounts in a mount namespace that ends with them.

    Attributes:
        leader: process id of its systemd, seen from outside; root: its root directory, seen from outside.
    """

    def __init__(self) -> None:
        self.name = f"fringed-{secrets.token_hex(4)}"
        self.leader = 0
        self._folder = Path(tempfile.mkdtemp(prefix="fringed-nspawn-"))
        self._outer: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Machine:
        try:
            self._start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def root(self) -> Path:
        """The container's root directory, seen from outside."""
        return Path(f"/proc/{self.leader}/root")

    def close(self) -> None:
        """Kill all its processes; may be called twice."""
        if self._outer is not None:
            self._outer.kill()
            self._outer.wait()
            wait_until(
                lambda: not self.leader or not _alive(self.leader), WAIT_S, "the container's end", poll_s=_POLL_S
            )
            self._outer = None
        shutil.rmtree(self._folder, ignore_errors=True)

    def run(
        self,
        *command: str,
        check: bool = True,
        env: Mapping[str, str] | None = None,
        user: str = "",
        timeout_s: float = WAIT_S,
    ) -> subprocess.CompletedProcess[str]:
        """Run a command inside, outside every unit; its output is text.

        Args:
            command: program and arguments, no shell.
            check: raise MachineError when it does not end with 0.
            env: added to PATH, LANG and HOME, the only others; user: its user, root if empty.
        """
        done = subprocess.run(
            self._inside(command, env or {}, user),
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
        if check and done.returncode:
            raise MachineError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
        return done

    def python(self, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
        """Run the interpreter inside, with the checkout and the environment's packages."""
        env = {"PYTHONPATH": CHECKOUT, "PYTHONDONTWRITEBYTECODE": "1"} | dict(options.pop("env", None) or {})
        return self.run(f"{VENV}/bin/python", *arguments, env=env, **options)

    def fringed(self, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
        """Run ``fringed`` of the checkout, not of the installation inside."""
        start = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
        return self.python("-c", start, *arguments, **options)

    def systemctl(self, *arguments: str, check: bool = True, timeout_s: float = WAIT_S) -> str:
        """Run systemctl and return its output."""
        return self.run("systemctl", "--no-pager", *arguments, check=check, timeout_s=timeout_s).stdout.strip()

    def show(self, unit: str, *names: str) -> dict[str, str]:
        """Return properties of a unit."""
        output = self.systemctl("show", unit, f"--property={','.join(names)}")
        return dict(line.partition("=")[::2] for line in output.splitlines() if "=" in line)

    def wait_show(self, unit: str, what: str, good: Callable[[dict[str, str]], bool], *names: str) -> dict[str, str]:
        """Return the unit's properties once the condition holds; MachineError with its journal after WAIT_S."""
        last: dict[str, str] = {}

        def probe() -> bool:
            last.clear()
            last.update(self.show(unit, *names))
            return good(last)

        try:
            wait_until(probe, WAIT_S, what, poll_s=_POLL_S)
        except TimeoutError as error:
            raise MachineError(f"{error}; {unit} has {last}\n{self.tail(unit)}") from None
        return last

    def journal(self, unit: str, *more: str) -> list[dict[str, Any]]:
        """Return all messages of a unit, oldest first, with all their fields."""
        output = self.run("journalctl", "--no-pager", "--output=json", f"--unit={unit}", *more).stdout
        return [json.loads(line) for line in output.splitlines() if line.startswith("{")]

    def tail(self, unit: str, lines: int = 60) -> str:
        """Return the end of a unit's journal, for messages of failure."""
        output = self.run("journalctl", "--no-pager", f"--lines={lines}", f"--unit={unit}", check=False).stdout
        return output or "its journal is empty"

    def _inside(self, command: Sequence[str], env: Mapping[str, str], user: str) -> list[str]:
        entered = ["nsenter", f"--target={self.leader}", "--all", "--", "env", "-i"]
        entered += [f"{key}={value}" for key, value in {**_ENVIRONMENT, **env}.items()]
        if user:
            entered += ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups"]
        return [*entered, *command]

    def _start(self) -> None:
        self._log = self._folder / "console"
        root = self._folder / "root"
        root.mkdir()
        checkout = Path(__file__).resolve().parents[2]
        given = [str(root), self.name, str(checkout), sysconfig.get_path("purelib"), sys.base_prefix]
        spaces = ["unshare", "--mount", "--propagation=private", "--pid", "--fork", "--kill-child=KILL", "--mount-proc"]
        command = ["setpriv", "--pdeathsig=KILL", *spaces, sys.executable, "-m", "tools.nspawn.boot", *given]
        with self._log.open("wb") as log:
            self._outer = subprocess.Popen(
                command, cwd=checkout, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=os.environ | _ENVIRONMENT
            )
        self._wait("its systemd", self._find_leader)
        self._wait("its boot", self._booted)
        if not sys.base_prefix.startswith("/usr"):
            self.run("ldconfig")

    def _wait(self, what: str, condition: Callable[[], bool]) -> None:
        def probe() -> bool:
            if self._outer is not None and self._outer.poll() is not None:
                output = self._log.read_text(errors="replace")
                raise MachineError(f"the container ended with {self._outer.returncode} before {what}\n{output}")
            return condition()

        wait_until(probe, WAIT_S, what, poll_s=_POLL_S)

    def _find_leader(self) -> bool:
        """Return the process id of systemd-nspawn's child; the child of unshare became systemd-nspawn."""
        assert self._outer is not None
        for boot in _children(self._outer.pid):
            for leader in _children(boot):
                with suppress(OSError):  # it may have ended since
                    if Path(f"/proc/{leader}/comm").read_text().strip() in ("systemd", "init"):
                        self.leader = leader
        return self.leader != 0

    def _booted(self) -> bool:
        return self.run("systemctl", "is-system-running", check=False).stdout.strip() in ("running", "degraded")


def _alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def _children(pid: int) -> list[int]:
    """Return the children of a process; none when it has ended."""
    found = []
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            output = status.read_text()
        except OSError:
            continue
        if f"\nPPid:\t{pid}\n" in output:
            found.append(int(status.parent.name))
    return found
