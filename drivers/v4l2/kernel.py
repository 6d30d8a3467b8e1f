"""The few calls by which the driver reaches the kernel, behind a protocol so that rare answers can be tested."""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import os
import select
from typing import Protocol

Argument = ctypes.Structure | ctypes.c_int


class Memory(Protocol):
    """A mapped buffer: readable by ``memoryview``, given back by ``close``."""

    def __buffer__(self, flags: int, /) -> memoryview:
        """The bytes."""

    def close(self) -> None:
        """Unmap; BufferError while a view is still alive."""


class Kernel(Protocol):
    """What a driver asks of the operating system; every method may raise OSError."""

    def open(self, path: str) -> int:
        """A file descriptor, non-blocking."""

    def close(self, fd: int) -> None:
        """Give the descriptor back."""

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        """One request; the answer is written into the argument."""

    def map(self, fd: int, length: int, offset: int) -> Memory:
        """The memory of a buffer."""

    def wait(self, fd: int, timeout_s: float) -> bool:
        """True when a frame or an error waits, False when the time is over."""


class LinuxKernel:
    """The real one. Requests and waiting let other threads run (the interpreter's lock is released)."""

    def open(self, path: str) -> int:
        """Open for reading and writing: settings need both."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self, fd: int) -> None:
        """Close the descriptor."""
        os.close(fd)

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        """``ioctl(2)``, started again when a signal interrupted it."""
        while True:
            try:
                fcntl.ioctl(fd, request, argument, True)
                return
            except InterruptedError:
                continue

    def map(self, fd: int, length: int, offset: int) -> Memory:
        """Shared mapping: the images are read where the device wrote them."""
        return mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset)

    def wait(self, fd: int, timeout_s: float) -> bool:
        """``poll(2)``; an error on the descriptor counts as something to fetch: the next request tells which."""
        poll = select.poll()
        poll.register(fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000))
