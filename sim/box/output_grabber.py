"""Pixels that an X server shows on one output.

It uses libxcb, because Xlib ends the whole process when a server dies. The pixels are read through shared memory
(MIT-SHM 1.2), which the kernel frees with its last user.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import select
import time
from dataclasses import dataclass
from types import TracebackType

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.box.xcb import Xcb, load

_ALL_PLANES, _Z_PIXMAP = 0xFFFFFFFF, 2
_MOST_PIXELS = 1 << 26


class DisplayLost(RuntimeError):
    """The X server has ended, does not answer, or has no such output."""


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A part of the X screen, pixels."""

    x: int
    y: int
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or self.width * self.height > _MOST_PIXELS or min(self.x, self.y) < 0:
            raise ValueError(f"rectangle {self}: expected 1 to {_MOST_PIXELS} pixels and a position of 0 or more")


class Grabber:
    """Reads the pixels of one output; connects at the first :meth:`grab`, and again after a loss.

    Not for several threads at once.

    Args:
        display: of the X server, for instance ``:7``.
        region: name of the RandR output (``DUMMY1``), looked up at every connection, or a rectangle of the screen.
        timeout_s: how long the server may take to answer.
    """

    def __init__(self, display: str, region: str | Rectangle, *, timeout_s: float = 5.0) -> None:
        self.display, self.region = display, region
        self._timeout_s = timeout_s
        self._connection: _Connection | None = None

    def grab(self) -> NDArray[np.uint8]:
        """The output's pixels now, (H, W, 3) uint8, R G B; a new array.

        Raises:
            DisplayLost: the message gives the reason; the next call connects again.
        """
        try:
            if self._connection is None:
                self._connection = _Connection(self.display, self.region, self._timeout_s)
            return self._connection.grab()
        except DisplayLost:
            self.close()
            raise

    def close(self) -> None:
        """Disconnect; :meth:`grab` connects again."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def __enter__(self) -> Grabber:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Connection:
    """One connection to a server, with the shared memory for one image."""

    def __init__(self, display: str, region: str | Rectangle, timeout_s: float) -> None:
        self._xcb: Xcb = load()
        self._display, self._timeout_s = display, timeout_s
        self._memory: mmap.mmap | None = None
        self._c = self._xcb.connect(display)
        try:
            if self._xcb.has_error(self._c):
                raise DisplayLost(f"display {display}: no X server accepts a connection")
            screen = self._xcb.screen(self._c)
            if screen.root_depth not in (24, 32):
                raise DisplayLost(f"display {display}: its depth is {screen.root_depth}, expected 24 (8 bits a colour)")
            self._root = screen.root
            self.rectangle = region if isinstance(region, Rectangle) else self._find(region)
            self._share()
        except BaseException:
            self.close()
            raise

    def grab(self) -> NDArray[np.uint8]:
        box = self.rectangle
        cookie = self._xcb.shm_get_image(
            self._c, self._root, box.x, box.y, box.width, box.height, _ALL_PLANES, _Z_PIXMAP, self._segment, 0
        )
        self._xcb.free(self._reply(cookie, f"reading {box}"))
        assert self._memory is not None  # noqa: S101 - for the type checker
        pixels = np.frombuffer(self._memory, np.uint8, 4 * box.width * box.height)
        # On little-endian machines the bytes are in the order blue, green, red.
        return np.asarray(cv2.cvtColor(pixels.reshape(box.height, box.width, 4), cv2.COLOR_BGRA2RGB))

    def close(self) -> None:
        self._xcb.disconnect(self._c)
        if self._memory is not None:
            self._memory.close()
            self._memory = None

    def _find(self, output: str) -> Rectangle:
        reply = self._reply(self._xcb.randr_get_monitors(self._c, self._root, 1), "requesting its outputs")
        try:
            monitors = self._xcb.monitors(reply)
        finally:
            self._xcb.free(reply)
        names = {}
        for m in monitors:
            answer = self._reply(self._xcb.get_atom_name(self._c, m.name), "requesting an output's name")
            names[self._xcb.atom_name(answer)] = Rectangle(m.x, m.y, m.width, m.height)
            self._xcb.free(answer)
        if output not in names:
            available = ", ".join(names) or "none"
            raise DisplayLost(f"display {self._display}: it has no output {output!r}; there are: {available}")
        return names[output]

    def _share(self) -> None:
        size = 4 * self.rectangle.width * self.rectangle.height
        fd = os.memfd_create("fringed-grab", os.MFD_CLOEXEC)
        try:
            os.ftruncate(fd, size)
            self._memory = mmap.mmap(fd, size)
            self._segment = self._xcb.generate_id(self._c)
            # libxcb closes the descriptor that it sends.
            cookie = self._xcb.shm_attach_fd_checked(self._c, self._segment, os.dup(fd), 0)
        finally:
            os.close(fd)
        error = self._xcb.request_check(self._c, cookie)
        if error:
            self._xcb.free(error)
            raise DisplayLost(f"display {self._display}: it shares no memory (MIT-SHM 1.2 is missing or was rejected)")

    def _reply(self, cookie: ctypes.Structure, what: str) -> int:
        """Address of the reply to a request; the caller frees it."""
        reply, error = ctypes.c_void_p(), ctypes.c_void_p()
        self._xcb.flush(self._c)
        fd, deadline = self._xcb.file_descriptor(self._c), time.monotonic() + self._timeout_s
        while not self._xcb.poll_for_reply(self._c, cookie.sequence, ctypes.byref(reply), ctypes.byref(error)):
            if self._xcb.has_error(self._c):
                raise DisplayLost(f"display {self._display}: the X server has ended ({what})")
            left = deadline - time.monotonic()
            if left <= 0:
                raise DisplayLost(f"display {self._display}: no answer within {self._timeout_s} s ({what})")
            select.select([fd], [], [], left)
        if error.value:
            self._xcb.free(error)
            raise DisplayLost(f"display {self._display}: the X server rejected the request ({what})")
        if not reply.value:
            raise DisplayLost(f"display {self._display}: the X server has ended ({what})")
        return reply.value
