"""The driver's system calls, behind a protocol so that rare results can be tested."""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import os
import select
from typing import Protocol

Argument = ctypes.Structure | ctypes.c_int


class Memory(Protocol):
    """A mapped buffer: readable by ``memoryview``, unmapped by ``close``."""

    def __buffer__(self, flags: int, /) -> memoryview:
        """The bytes."""

    def close(self) -> None:
        """Unmap; BufferError while a view exists."""


class Kernel(Protocol):
    """The system calls of a driver; every method may raise OSError."""

    def open(self, path: str) -> int:
        """Open a file, non-blocking; return its descriptor."""

    def close(self, fd: int) -> None:
        """Close the descriptor."""

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        """Execute a request; its result is written into the argument."""

    def map(self, fd: int, length: int, offset: int) -> Memory:
        """Map the memory of a buffer."""

    def wait(self, fd: int, timeout_s: float) -> bool:
        """Return True when a frame or an error waits, False after the time-out."""


class LinuxKernel:
    """The system's kernel. Requests and waiting release the interpreter's lock."""

    def open(self, path: str) -> int:
        """Open for reading and writing: settings need both."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self, fd: int) -> None:
        """Close the descriptor."""
        os.close(fd)

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        """Call ``ioctl(2)``, again when a signal interrupted it."""
        while True:
            try:
                fcntl.ioctl(fd, request, argument, True)
                return
            except InterruptedError:
                continue

    def map(self, fd: int, length: int, offset: int) -> Memory:
        """Map shared: the images are read where the device wrote them."""
        return mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset)

    def wait(self, fd: int, timeout_s: float) -> bool:
        """Call ``poll(2)``; an error on the descriptor counts as ready: the next request reports it."""
        poll = select.poll()
        poll.register(fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000))
