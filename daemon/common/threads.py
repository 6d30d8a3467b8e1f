"""Threads as the operating system sees them: their names, and the processors that they run on.

A new thread inherits both from the thread that starts it: numba's workers, which the pipeline's thread starts, run on
its processors.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

_TASKS = Path("/proc/self/task")
_MAX_NAME = 15  # characters that Linux keeps


def ids() -> set[int]:
    """Kernel ids of all threads of this process, those of libraries included."""
    return {int(task.name) for task in _TASKS.iterdir()}


def name(thread: int, text: str) -> None:
    """Give a thread a name that ``top -H`` and ``/proc`` show; nothing happens if it has ended."""
    with suppress(OSError):
        (_TASKS / str(thread) / "comm").write_text(text[:_MAX_NAME])


def pin(threads: Iterable[int], cpus: Iterable[int]) -> None:
    """Let threads run on these processors alone; OSError when none of them exists."""
    allowed = frozenset(cpus)
    for thread in threads:
        with suppress(ProcessLookupError):
            os.sched_setaffinity(thread, allowed)


def available() -> frozenset[int]:
    """The processors that this thread may run on."""
    return frozenset(os.sched_getaffinity(0))


def _name_of(thread: threading.Thread) -> str:
    """Its name, or its class where a library gave it none."""
    plain = re.fullmatch(r"Thread-\d+", thread.name)
    return type(thread).__name__ if plain else thread.name


class ThreadNamer:
    """Gives every Python thread its name in the kernel, which Python does only from 3.14 on."""

    def __init__(self, main: str) -> None:
        self._main = main
        self._named: set[tuple[int, str]] = set()

    def update(self) -> None:
        """Name the threads that are new since the last call."""
        now = {
            (thread.native_id, self._main if thread is threading.main_thread() else _name_of(thread))
            for thread in threading.enumerate()
            if thread.native_id is not None
        }
        for number, text in now - self._named:
            name(number, text)
        self._named = now
