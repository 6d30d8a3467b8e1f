"""Run the checks in a process of their own: one that crashes or hangs becomes a finding, and the others go on."""

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

from daemon.apps.doctor.check_process import Done, Job
from daemon.apps.doctor.check_table import AREAS, Check
from daemon.apps.doctor.finding import Finding
from drivers import child_process

log = logging.getLogger("fringed.doctor")

START_S = 60.0
_MAX_LINE = 1 << 20


def examine(
    rig: Path | None = None,
    *,
    checks: Sequence[Check] = AREAS,
    root: Path = Path("/"),
    on_area: Callable[[list[Finding]], None] = lambda _: None,
) -> list[Finding]:
    """Look at everything, in order.

    Args:
        rig: a rig.yaml; None = the machine in general. root: where /proc, /sys, /dev and /etc begin.
        on_area: is told the findings of each area as soon as they are there.
    """
    found: list[Finding] = []
    pending = list(checks)
    while pending:
        job = Job(tuple(pending), str(rig.resolve()) if rig is not None else "", str(root))
        with _Worker(job) as worker:
            if worker.next(START_S) is None:
                text = f"the checks cannot be started: {worker.end()}"
                found.append(
                    Finding("doctor", "start", "problem", text, "mend the installation: pip install 'fringed[rig]'")
                )
                on_area(found[-1:])
                return found
            while pending:
                check = pending.pop(0)
                done = worker.next(check.timeout_s)
                findings = [broken(check, worker.end())] if done is None else list(done.findings)
                found += findings
                on_area(findings)
                if done is None:
                    break
    return found


def broken(check: Check, why: str) -> Finding:
    """The finding in place of a check that gave no answer."""
    remedy = (
        f"restart what the area {check.area} asks (device, X server, disk, vendor's library); "
        f"then look at it alone with: fringed doctor --only {check.area}"
    )
    return Finding(check.area, "check", "problem", f"the check gave no answer: {why}", remedy)


class _Worker:
    """The process with the checks."""

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
        self._prints = child_process.OutputReader(self._process, log, "doctor-prints")
        self._text = b""
        self._late = False
        self._ended = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._late = self._late or kind is not None  # Ctrl-C waits for nobody
        self.end()
        os.close(self._reading)

    def next(self, timeout_s: float) -> Done | None:
        """The next answer, None if there is none in time or the process has ended."""
        deadline = time.monotonic() + timeout_s
        poll = select.poll()
        poll.register(self._reading, select.POLLIN)
        while b"\n" not in self._text:
            if not poll.poll(max(deadline - time.monotonic(), 0) * 1000):
                self._late = True
                return None
            part = os.read(self._reading, 65536)
            if not part or len(self._text) > _MAX_LINE:
                return None
            self._text += part
        line, _, self._text = self._text.partition(b"\n")
        try:
            return msgspec.json.decode(line, type=Done)
        except (msgspec.MsgspecError, ValueError):
            return None

    def _await_end(self) -> None:
        """Give it the time to end by itself, without taking its exit status."""
        handle = os.pidfd_open(self._process.pid)
        try:
            select.select([handle], [], [], 2.0)
        finally:
            os.close(handle)

    def end(self) -> str:
        """End the process and all that it started; says how it ended. May be called twice."""
        if self._ended:
            return self._ended
        if not self._late:
            self._await_end()
        # The process has not been waited for yet, so that its number and its group still belong to it.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)  # with whatever it has started
        with suppress(ProcessLookupError):
            os.kill(self._process.pid, signal.SIGKILL)
        status = self._process.wait()
        self._prints.join(1.0)
        how = f"ended by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        said = f"{how}; {self._prints.text()}"[:600] if self._prints.text() else how
        self._ended = "it did not come to an end in time" if self._late else said
        return self._ended
