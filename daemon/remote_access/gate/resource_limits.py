"""Resource limits of the gate process: descriptors and memory."""

from __future__ import annotations

import ctypes
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

_SPARE = 32
_MOST_CHECKED = 4096
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8  # numbers of mallopt(3)


def prepare() -> None:
    """Make the allocator return large messages to the kernel and keep few heaps."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return  # not glibc: there is nothing to set
    mallopt(_MMAP_THRESHOLD, 256 * 1024)
    mallopt(_ARENA_MAX, 2)


def trim() -> None:
    """Return free memory to the kernel."""
    trimmer = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc only
    if trimmer is not None:
        trimmer(0)


class Memory:
    """Memory use of this process; its file stays open for when there are no descriptors left."""

    def __init__(self) -> None:
        self._file = os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)

    def bytes(self) -> int:
        """Return the resident memory."""
        return int(os.pread(self._file, 200, 0).split()[1]) * os.sysconf("SC_PAGE_SIZE")


def open_descriptors() -> int:
    """Return the number of open files and sockets of this process; uses no descriptor."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return sum(map(_is_open, range(min(soft + _SPARE, _MOST_CHECKED))))


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


def allow_descriptors(most: int) -> None:
    """Limit the open files and sockets; ZeroMQ then leaves further connections waiting."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard - _SPARE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


@contextmanager
def spare_descriptors() -> Iterator[None]:
    """Allow some more descriptors in the block, to bind again when connections have taken all."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    more = soft + _SPARE if hard == resource.RLIM_INFINITY else min(soft + _SPARE, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (more, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
