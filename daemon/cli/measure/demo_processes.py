"""The demo's viewer process and its status lines."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Callable
from typing import Any

from daemon.bootstrap.systemd.status_line import line, loading
from drivers.child_process import interpreter

_VIEW = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"


class Viewer:
    """``fringed view --web`` as a process, independent of the measurement."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self._process: subprocess.Popen[bytes] | None = None
        self._reported = False

    def start(self) -> None:
        """Start the process once; it prints its address."""
        if self._process is None:
            command = [*interpreter(), "-c", _VIEW, "view", self._endpoint, "--web"]
            self._process = subprocess.Popen(command, start_new_session=True, stdin=subprocess.DEVNULL)

    def ended(self) -> int | None:
        """The exit status of a viewer that ended by itself, returned once; else None."""
        if self._process is None or self._reported or self._process.poll() is None:
            return None
        self._reported = True
        return self._process.returncode

    def close(self) -> None:
        """End the process and its children."""
        if self._process is None:
            return
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(5.0)


class Report:
    """Called with the status once a second: prints a line, starts the viewer, ends the demo in time.

    Args:
        seconds: duration of the measurement, after which ``stop`` is called; None = unlimited.
        echo: prints a line; now_s: monotonic seconds.
    """

    def __init__(
        self,
        seconds: float | None,
        *,
        stop: Callable[[], None],
        viewer: Viewer | None,
        echo: Callable[[str], object],
        now_s: Callable[[], float],
    ) -> None:
        self._seconds, self._stop, self._viewer, self._echo, self._now_s = seconds, stop, viewer, echo, now_s
        self._measuring_since_s: float | None = None

    def __call__(self, status: dict[str, Any]) -> None:
        """Report a status."""
        if status["state"] == "starting":
            self._echo(loading(status))
            return
        if self._measuring_since_s is None:
            self._measuring_since_s = self._now_s()
            if self._viewer is not None:
                self._viewer.start()
        code = self._viewer.ended() if self._viewer is not None else None
        if code is not None:
            self._echo(f"the viewer ended (exit status {code}); measuring continues")
        self._echo(line(status))
        if self._seconds is not None and self._now_s() - self._measuring_since_s >= self._seconds:
            self._stop()
