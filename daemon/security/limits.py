"""Bounds of the gate's own process: descriptors and memory."""

from __future__ import annotations

import ctypes
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SPARE = 32
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


def memory_bytes() -> int:
    """What this process has in memory."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def open_descriptors() -> int:
    """How many files and sockets this process has open."""
    return len(os.listdir("/proc/self/fd")) - 1  # noqa: PTH208 - and one for looking


def allow_descriptors(most: int) -> None:
    """Refuse more files and sockets than this: ZeroMQ then leaves further connections waiting."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard - _SPARE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


@contextmanager
def spare_descriptors() -> Iterator[None]:
    """Some more descriptors for the block: when connections have taken all, one's own files can still be read."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    more = soft + _SPARE if hard == resource.RLIM_INFINITY else min(soft + _SPARE, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (more, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
