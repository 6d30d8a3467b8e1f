"""Run another program with a limit to its time and its output."""

from __future__ import annotations

import shutil
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

MAX_BYTES = 1 << 16


@dataclass(frozen=True, slots=True)
class ProgramResult:
    """Output and exit status; ``status`` is None after a time-out, negative where a signal ended it."""

    status: int | None
    out: str = ""
    err: str = ""

    @property
    def problem(self) -> str:
        """Why it failed, in one phrase."""
        if self.status is None:
            return "it does not end"
        if self.status < 0:
            return f"it is ended by {signal.Signals(-self.status).name}"
        last = self.err.splitlines()[-1:] or self.out.splitlines()[-1:]
        return last[0][:400] if last else f"exit status {self.status}"


def is_installed(program: str) -> bool:
    """Whether a program is installed."""
    return shutil.which(program) is not None


def run_program(command: Sequence[str], timeout_s: float, environ: Mapping[str, str] | None = None) -> ProgramResult:
    """Run a program without a shell; OSError where it cannot be started."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        try:
            status: int | None = subprocess.run(  # fixed programs, no shell
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                timeout=timeout_s,
                env=environ,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            status = None
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read(MAX_BYTES).decode(errors="replace").strip())
    return ProgramResult(status, *texts)
