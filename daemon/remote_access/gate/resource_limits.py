"""Bounds of the gate's own process: descriptors and memory."""

from __future__ import annotations

import ctypes
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

_SPARE = 32
_MOST_LOOKED_AT = 4096
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8  # numbers of mallopt(3)


def prepare() -> None:
    """Let the allocator give large messages back to the kernel, and keep few heaps."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return  # another C library: it has its own ways
    mallopt(_MMAP_THRESHOLD, 256 * 1024)
    mallopt(_ARENA_MAX, 2)


def trim() -> None:
    """Give memory that is free back to the kernel."""
    trimmer = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trimmer is not None:
        trimmer(0)


class Memory:
    """What this process has in memory; its file stays open for the time when there are no descriptors left."""

    def __init__(self) -> None:
        self._file = os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)

    def bytes(self) -> int:
        """Now."""
        return int(os.pread(self._file, 200, 0).split()[1]) * os.sysconf("SC_PAGE_SIZE")


def open_descriptors() -> int:
    """How many files and sockets this process has open; costs no descriptor."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return sum(map(_is_open, range(min(soft + _SPARE, _MOST_LOOKED_AT))))


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


def allow_descriptors(most: int) -> None:
    """Refuse more files and sockets than this: ZeroMQ then leaves further connections waiting."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard - _SPARE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


@contextmanager
def spare_descriptors() -> Iterator[None]:
    """Some more descriptors for the block, to begin anew when connections have taken all."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    more = soft + _SPARE if hard == resource.RLIM_INFINITY else min(soft + _SPARE, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (more, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
