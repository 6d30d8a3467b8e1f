"""A daemon in a process of its own, as a user starts it, restarted as a service manager would if it ends."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fringed.control.client import ControlClient
from fringed.errors import ControlError
from tools.waiting import wait_until

FRINGED = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
_END_S = 60.0
_POLL_S = 0.02


class DaemonProcess:
    """``fringed run RIG`` until the block ends.

    Args:
        rig_file: of the rig; control: its control endpoint; log: file of its output.
        arguments: further ones; environment: further variables.
        restart: start it again whenever it ends, and kill it when its watchdog starves, as systemd would.
        watchdog_s: timeout of that watchdog; it begins with the daemon's first notification.
    """

    def __init__(
        self,
        rig_file: Path,
        control: str,
        log: Path,
        *,
        arguments: tuple[str, ...] = (),
        environment: Mapping[str, str] | None = None,
        restart: bool = False,
        watchdog_s: float = 10.0,
    ) -> None:
        self.control, self.log = control, log
        self.starts = 0
        self._command = [sys.executable, "-c", FRINGED, "run", str(rig_file), *arguments]
        self._restart, self._watchdog_s = restart, watchdog_s
        self._over = threading.Event()
        self._notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._notify.bind(str(log.with_suffix(".notify")))
        self._notify.settimeout(_POLL_S)
        self._environment = os.environ | dict(environment or {})
        if restart:
            self._environment |= {
                "NOTIFY_SOCKET": str(log.with_suffix(".notify")),
                "WATCHDOG_USEC": str(round(1e6 * watchdog_s)),
            }
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._watch, name="guard", daemon=True)

    def __enter__(self) -> Self:
        self._start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        process = self._process
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._notify.close()

    @property
    def pid(self) -> int:
        """Of the daemon that runs now, or ran last."""
        return self._process.pid if self._process is not None else 0

    def signal(self, number: signal.Signals) -> None:
        """Send the daemon a signal."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)

    def ask(self, method: str, *, timeout_s: float = 5.0, **params: Any) -> Any:
        """The result of a control method; ControlError when there is none."""
        with ControlClient(self.control, timeout_s=timeout_s) as client:
            return client.call(method, **params)

    def until(self, good: Callable[[dict[str, Any]], object], timeout_s: float, what: str) -> dict[str, Any]:
        """The first status that is good; TimeoutError, with the last status, when none is in time."""
        last: dict[str, Any] = {}

        def status() -> dict[str, Any] | None:
            try:
                last.update(self.ask("status", timeout_s=2.0))
            except ControlError:
                if self._process is not None and self._process.poll() is not None and not self._restart:
                    raise TimeoutError(f"the daemon ended before {what}") from None
                return None
            return last if good(last) else None

        try:
            return wait_until(status, timeout_s, what, poll_s=0.05) or last
        except TimeoutError as error:
            raise TimeoutError(f"{error}; status {last}\n{self.log.read_text()[-4000:]}") from None

    def children(self, word: str) -> list[int]:
        """Child processes of the daemon whose command line contains this word."""
        return [pid for pid in tree(self.pid) if pid != self.pid and word in _command_line(pid)]

    def _start(self) -> None:
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(self._command, stderr=log, stdout=log, env=self._environment)
        self.starts += 1
        self._alive_s: float | None = None

    def _watch(self) -> None:
        """Restart the daemon when it ended, kill it when its watchdog starves, if ``restart`` is set."""
        while not self._over.is_set():
            try:
                if b"WATCHDOG=1" in self._notify.recv(4096):
                    self._alive_s = time.monotonic()
            except TimeoutError:
                pass
            process = self._process
            if not self._restart or process is None:
                continue
            if process.poll() is not None:
                self._start()
            elif self._alive_s is not None and time.monotonic() - self._alive_s > self._watchdog_s:
                process.kill()


def tree(pid: int) -> Iterator[int]:
    """A process and its descendants."""
    yield pid
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
    except OSError:
        return
    for task in tasks:
        try:
            children = (task / "children").read_text().split()
        except OSError:
            continue
        for child in children:
            yield from tree(int(child))


def _command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""
