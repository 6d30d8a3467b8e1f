"""Compilation in as many processes as there are processors, with its progress."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from daemon.common import threads
from daemon.common.errors import DaemonError
from daemon.kernels import cache, release

_END_S = 5.0
_TAIL = 2000


class Progress(NamedTuple):
    """Jobs whose kernels are ready, and all of them."""

    done: int
    total: int


class KernelCompilation:
    """Compiles what is missing of some jobs, from :meth:`start` on.

    Args:
        jobs: see :mod:`daemon.kernels.jobs`; those that take longest first.
        processes: how many; 0 = one for each processor that this process may use.
    """

    def __init__(self, jobs: Iterable[str], *, processes: int = 0) -> None:
        release.unpack()
        wanted = list(dict.fromkeys(jobs))
        ready = cache.compiled_jobs()
        self._waiting = deque(job for job in wanted if job not in ready)
        self._count = min(processes or len(threads.available()), len(self._waiting))
        self._total, self._done = len(wanted), len(wanted) - len(self._waiting)
        self._lock, self._problem = threading.Lock(), ""
        self._processes: list[subprocess.Popen[str]] = []
        self._threads: list[threading.Thread] = []

    @property
    def progress(self) -> Progress:
        """How far it is."""
        return Progress(self._done, self._total)

    def start(self) -> KernelCompilation:
        """Start the processes; returns at once."""
        if self._count:
            cache.discard_outdated()
        for number in range(self._count):
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "daemon.kernels.worker"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.PIPE, text=True, start_new_session=True,
            )  # fmt: skip
            thread = threading.Thread(target=self._feed, args=(process,), name=f"compile-{number}", daemon=True)
            self._processes.append(process)
            self._threads.append(thread)
            thread.start()
        return self

    def wait(self, notify: Callable[[Progress], object] | None = None, *, every_s: float = 1.0) -> None:
        """Wait until all jobs are done.

        Args:
            notify: called with the progress now and then.

        Raises:
            DaemonError: a process failed.
        """
        for thread in self._threads:
            while thread.is_alive():
                thread.join(every_s)
                if notify is not None:
                    notify(self.progress)
        if self._problem:
            raise DaemonError(f"the compilation of the kernels failed:\n{self._problem}")

    def close(self) -> None:
        """End the processes."""
        with self._lock:
            self._waiting.clear()
        for process in self._processes:
            process.kill()
        for thread in self._threads:
            thread.join(_END_S)

    def _feed(self, process: subprocess.Popen[str]) -> None:
        """Give a process one job after the other."""
        with process:
            given, answers, problems = process.stdin, process.stdout, process.stderr
            if given is None or answers is None or problems is None:  # all three are pipes
                return
            while True:
                with self._lock:
                    if not self._waiting or self._problem:
                        break
                    job = self._waiting.popleft()
                try:
                    given.write(job + "\n")
                    given.flush()
                    answer = answers.readline()
                except OSError:
                    answer = ""
                if answer.strip() != "done":
                    process.kill()
                    with self._lock:
                        self._problem = self._problem or f"{job}: {problems.read()[-_TAIL:].strip()}"
                    break
                with self._lock:
                    self._done += 1
                    cache.note_compiled([job])
            given.close()


_running: list[KernelCompilation] = []
"""Compilations that were started ahead in this process."""


@contextmanager
def compiling_ahead(jobs: Iterable[str]) -> Iterator[None]:
    """Compile in the background; :func:`compile_kernels` waits for it before it compiles what is then missing."""
    compilation = KernelCompilation(jobs).start()
    _running.append(compilation)
    try:
        yield
    finally:
        _running.remove(compilation)
        compilation.close()


def compile_kernels(jobs: Iterable[str], notify: Callable[[Progress], object] | None = None) -> None:
    """Compile what is missing of some jobs, and wait for it; see :class:`KernelCompilation`."""
    for ahead in list(_running):
        ahead.wait(notify)
    compilation = KernelCompilation(jobs).start()
    try:
        compilation.wait(notify)
    finally:
        compilation.close()
    if notify is not None:
        notify(compilation.progress)
