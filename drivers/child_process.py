"""Child processes that end with this one, and their output."""

from __future__ import annotations

import ctypes
import logging
import os
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import IO

from drivers.errors import DriverError

_PR_SET_PDEATHSIG = 1
_MAX_LINE = 2000
_KEPT_LINES = 8

_Job = tuple[Callable[[], "subprocess.Popen[bytes]"], "Future[subprocess.Popen[bytes]]"]
_jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
_starting = threading.Lock()
_thread: threading.Thread | None = None


def set_death_signal(number: signal.Signals) -> None:
    """Let the kernel send a signal to this process when the thread that started it ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this child process when the thread that started it ends; called in the child."""
    set_death_signal(signal.SIGKILL)
    if os.getppid() != parent:
        raise SystemExit("the process that started this one is gone")


def interpreter() -> list[str]:
    """This interpreter, for a child that imports what this process does.

    ``python -m`` and ``-c`` import from the working directory first, where a folder of the same name as a package would
    replace it; ``-P`` prevents this unless this process does so itself.
    """
    try:
        local = {"", str(Path.cwd())} & set(sys.path)
    except OSError:  # the directory was removed
        local = set()
    return [sys.executable] if local else [sys.executable, "-P"]


def start(module: str, arguments: Sequence[str], *, pass_fds: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Start ``python -m module``; its standard output and error share one pipe, ``stdout``.

    The kernel's parent-death signal refers to the *thread* that started a process, so all are started by one thread
    that lasts as long as this process.
    """
    global _thread
    with _starting:
        if _thread is None or not _thread.is_alive():
            _thread = threading.Thread(target=_work, name="process-starter", daemon=True)
            _thread.start()
    done: Future[subprocess.Popen[bytes]] = Future()

    def job() -> subprocess.Popen[bytes]:
        return subprocess.Popen(  # noqa: S603 - this very interpreter, no shell
            [*interpreter(), "-m", module, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=tuple(pass_fds),
            env=environment(),
        )

    _jobs.put((job, done))
    try:
        return done.result()
    except OSError as error:
        raise DriverError(f"a process for {module} cannot be started: {error}") from error


def _work() -> None:
    while True:
        job, done = _jobs.get()
        try:
            done.set_result(job())
        except BaseException as error:
            done.set_exception(error)


def environment() -> dict[str, str]:
    """Return this environment with the same module path and without unused thread pools for linear algebra."""
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    return {**one, **os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "PYTHONUNBUFFERED": "1"}


def end(process: subprocess.Popen[bytes], timeout_s: float) -> int:
    """Wait for a process and kill it after the time-out; return its exit status."""
    try:
        return process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


class OutputReader:
    """Passes the output of a process on to a logger, line by line, and keeps the last lines.

    Args:
        process: from :func:`start`; its output is closed at its end. name: of the thread that reads it.
    """

    def __init__(self, process: subprocess.Popen[bytes], log: logging.Logger, name: str) -> None:
        if process.stdout is None:
            raise ValueError("the process has no output to read")
        self._stream: IO[bytes] = process.stdout
        self._log = log
        self.last: deque[str] = deque(maxlen=_KEPT_LINES)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def text(self) -> str:
        """Return the last lines joined."""
        return " | ".join(self.last)

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the output."""
        self._thread.join(timeout_s)

    def _run(self) -> None:
        with self._stream:
            while line := self._stream.readline(_MAX_LINE):
                text = line.decode("utf-8", "replace").rstrip()
                if text:
                    self.last.append(text)
                    self._log.debug("%s", text)
