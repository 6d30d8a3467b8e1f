"""Stops one thread of a process of the container, like a driver call that never returns."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SEIZE, _INTERRUPT, _DETACH = 0x4206, 0x4207, 17
_WALL = 0x40000000


def thread_of(pid: int, name: str) -> int:
    """Return the first thread of a name in a process (pid outside); library threads inherit their maker's name."""
    found = [int(t.name) for t in Path(f"/proc/{pid}/task").iterdir() if (t / "comm").read_text().strip() == name]
    assert found, f"process {pid} has no thread {name}"
    return min(found)


@contextmanager
def frozen(tid: int) -> Iterator[None]:
    """Stop the thread inside the block; the others run on, and all of them can be killed."""
    held, over = threading.Event(), threading.Event()
    problems: list[OSError] = []

    def hold() -> None:
        """Attach, wait and detach in one thread, as the kernel requires."""
        try:
            _ptrace(_SEIZE, tid)
            _ptrace(_INTERRUPT, tid)
        except OSError as error:
            problems.append(error)
        held.set()
        # A thread killed while it is traced stays until its tracer has waited for it.
        while not problems and not _ended(tid):
            if over.wait(0.05):
                _ptrace(_DETACH, tid)
                return

    holder = threading.Thread(target=hold, daemon=True)
    holder.start()
    try:
        held.wait()
        if problems:
            raise problems[0]
        yield
    finally:
        over.set()
        holder.join()


def _ended(tid: int) -> bool:
    try:
        seen, status = os.waitpid(tid, os.WNOHANG | _WALL)
    except ChildProcessError:
        return True
    return bool(seen) and (os.WIFEXITED(status) or os.WIFSIGNALED(status))


def _ptrace(request: int, tid: int) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    library.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    if library.ptrace(request, tid, None, None) == -1:
        number = ctypes.get_errno()
        raise OSError(number, f"ptrace {request:#x} of thread {tid}: {os.strerror(number)}")
