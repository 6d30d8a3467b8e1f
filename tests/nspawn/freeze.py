"""Holds one thread of a process of the container, as a driver that never comes back would."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SEIZE, _INTERRUPT, _DETACH = 0x4206, 0x4207, 17


def threads(pid: int) -> dict[str, int]:
    """Thread ids by name, of a process as seen from here."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        found[(task / "comm").read_text().strip()] = int(task.name)
    return found


@contextmanager
def frozen(tid: int) -> Iterator[None]:
    """Inside the block the thread does nothing; the others go on."""
    _ptrace(_SEIZE, tid)
    _ptrace(_INTERRUPT, tid)
    try:
        yield
    finally:
        try:
            _reap(tid)
            _ptrace(_DETACH, tid)
        except ProcessLookupError:
            pass  # killed meanwhile, which is what should happen


def _ptrace(request: int, tid: int) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    library.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    if library.ptrace(request, tid, None, None) == -1:
        number = ctypes.get_errno()
        raise OSError(number, f"ptrace {request:#x} of thread {tid}: {os.strerror(number)}")


def _reap(tid: int) -> None:
    """A thread that was killed while it was held stays until its holder has seen it."""
    try:
        os.waitpid(tid, os.WNOHANG | 0x40000000)  # __WALL
    except ChildProcessError:
        return
