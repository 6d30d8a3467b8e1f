"""Run the checks in a process of their own: a crash or a hang becomes a finding, and the other checks continue."""

from __future__ import annotations

import logging
import os
import select
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from daemon.apps.doctor.check_process import AreaResult, Job
from daemon.apps.doctor.check_table import AREAS, Check
from daemon.apps.doctor.finding import Finding
from drivers import child_process

log = logging.getLogger("fringed.doctor")

START_S = 60.0
_MAX_LINE = 1 << 20


def run_checks(
    rig: Path | None = None,
    *,
    checks: Sequence[Check] = AREAS,
    root: Path = Path("/"),
    on_area: Callable[[list[Finding]], None] = lambda _: None,
) -> list[Finding]:
    """Run all checks in order.

    Args:
        rig: a rig.yaml; None = the machine in general. root: of /proc, /sys, /dev and /etc.
        on_area: called with the findings of each area as soon as they are complete.
    """
    findings: list[Finding] = []
    pending = list(checks)
    while pending:
        job = Job(tuple(pending), str(rig.resolve()) if rig is not None else "", str(root))
        with _CheckProcess(job) as process:
            if process.next(START_S) is None:
                text, remedy = f"the checks cannot start: {process.end()}", "install again: pip install fringed-rig"
                findings.append(Finding("doctor", "start", "problem", text, remedy))
                on_area(findings[-1:])
                return findings
            while pending:
                check = pending.pop(0)
                result = process.next(check.timeout_s)
                new = [failed_check(check, process.end())] if result is None else list(result.findings)
                findings += new
                on_area(new)
                if result is None:
                    break
    return findings


def failed_check(check: Check, reason: str) -> Finding:
    """The finding for a check without a result."""
    remedy = (
        f"restart what the area {check.area} uses (device, X server, disk, vendor's library); "
        f"then repeat this check with: fringed doctor --only {check.area}"
    )
    return Finding(check.area, "check", "problem", f"the check gave no result: {reason}", remedy)


class _CheckProcess:
    """The process that runs the checks."""

    def __init__(self, job: Job) -> None:
        self._reading, writing = os.pipe()
        try:
            arguments = [str(writing), str(os.getpid()), msgspec.json.encode(job).decode()]
            self._process: subprocess.Popen[bytes] = child_process.start(
                "daemon.apps.doctor.check_process", arguments, pass_fds=[writing]
            )
        except BaseException:
            os.close(self._reading)
            raise
        finally:
            os.close(writing)
        self._output = child_process.OutputReader(self._process, log, "doctor-prints")
        self._buffer = b""
        self._timed_out = False
        self._ended = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timed_out = self._timed_out or kind is not None  # no waiting after Ctrl-C
        self.end()
        os.close(self._reading)

    def next(self, timeout_s: float) -> AreaResult | None:
        """The next result, None after the time-out or the end of the process."""
        deadline = time.monotonic() + timeout_s
        poll = select.poll()
        poll.register(self._reading, select.POLLIN)
        while b"\n" not in self._buffer:
            if not poll.poll(max(deadline - time.monotonic(), 0) * 1000):
                self._timed_out = True
                return None
            part = os.read(self._reading, 65536)
            if not part or len(self._buffer) > _MAX_LINE:
                return None
            self._buffer += part
        line, _, self._buffer = self._buffer.partition(b"\n")
        try:
            return msgspec.json.decode(line, type=AreaResult)
        except (msgspec.MsgspecError, ValueError):
            return None

    def _await_end(self) -> None:
        """Wait up to two seconds for the end of the process, without collecting its exit status."""
        handle = os.pidfd_open(self._process.pid)
        try:
            select.select([handle], [], [], 2.0)
        finally:
            os.close(handle)

    def end(self) -> str:
        """End the process and its descendants; return ending it ended. Repeated calls are allowed."""
        if self._ended:
            return self._ended
        if not self._timed_out:
            self._await_end()
        # Its exit status is not collected yet, so its process id and group still belong to it.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        with suppress(ProcessLookupError):
            os.kill(self._process.pid, signal.SIGKILL)
        status = self._process.wait()
        self._output.join(1.0)
        ending = f"ended by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        output = f"{ending}; {self._output.text()}"[:600] if self._output.text() else ending
        self._ended = "it did not end in time" if self._timed_out else output
        return self._ended
