"""Vertical blanks as a clock: the X Present extension, by ctypes on libxcb-present, on a connection of its own.

``PresentNotifyMSC`` requests an event at a vertical blank of the output of a window; the event carries its number (msc)
and its time (ust, microseconds of CLOCK_MONOTONIC). Where OpenGL itself presents through this extension (Mesa with
DRI3), the completion of a buffer swap is reported as well, with the same two numbers.
"""

from __future__ import annotations

import ctypes
import select
import time
from ctypes import POINTER, Structure, byref, c_char_p, c_int, c_uint8, c_uint16, c_uint32, c_uint64, c_void_p
from dataclasses import dataclass
from functools import cache
from typing import Any

from drivers.errors import DriverError
from drivers.projector.x11.xlib import load

KIND_PIXMAP, KIND_MSC = 0, 1
COMPLETE_NOTIFY = 1
COMPLETE_NOTIFY_MASK = 2
PLAUSIBLE_S = 10.0


class CompleteNotify(Structure):
    """xcb_present_complete_notify_event_t, packed, with ``full_sequence`` inside."""

    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (
        ("response_type", c_uint8),
        ("extension", c_uint8),
        ("sequence", c_uint16),
        ("length", c_uint32),
        ("event_type", c_uint16),
        ("kind", c_uint8),
        ("mode", c_uint8),
        ("event", c_uint32),
        ("window", c_uint32),
        ("serial", c_uint32),
        ("ust", c_uint64),
        ("full_sequence", c_uint32),
        ("msc", c_uint64),
    )


class QueryExtensionReply(Structure):
    """Beginning of xcb_query_extension_reply_t."""

    _fields_ = (
        ("response_type", c_uint8),
        ("pad", c_uint8),
        ("sequence", c_uint16),
        ("length", c_uint32),
        ("present", c_uint8),
    )


XCB: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "xcb_connect": (c_void_p, (c_char_p, POINTER(c_int))),
    "xcb_connection_has_error": (c_int, (c_void_p,)),
    "xcb_get_file_descriptor": (c_int, (c_void_p,)),
    "xcb_generate_id": (c_uint32, (c_void_p,)),
    "xcb_get_extension_data": (POINTER(QueryExtensionReply), (c_void_p, c_void_p)),
    "xcb_register_for_special_xge": (c_void_p, (c_void_p, c_void_p, c_uint32, POINTER(c_uint32))),
    "xcb_poll_for_special_event": (c_void_p, (c_void_p, c_void_p)),
    "xcb_poll_for_event": (c_void_p, (c_void_p,)),
    "xcb_flush": (c_int, (c_void_p,)),
    "xcb_disconnect": (None, (c_void_p,)),
}
PRESENT: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "xcb_present_query_version": (c_uint32, (c_void_p, c_uint32, c_uint32)),
    "xcb_present_query_version_reply": (c_void_p, (c_void_p, c_uint32, POINTER(c_void_p))),
    "xcb_present_select_input": (c_uint32, (c_void_p, c_uint32, c_uint32, c_uint32)),
    "xcb_present_notify_msc": (c_uint32, (c_void_p, c_uint32, c_uint32, c_uint64, c_uint64, c_uint64)),
}


@cache
def _libraries() -> tuple[ctypes.CDLL, ctypes.CDLL, ctypes.CDLL]:
    libc = load("libc.so.6", {"free": (None, (c_void_p,))})
    return load("libxcb.so.1", XCB), load("libxcb-present.so.0", PRESENT), libc


@dataclass(frozen=True, slots=True)
class VBlank:
    """One vertical blank: its number, its time (CLOCK_MONOTONIC, ns; 0 = unknown), and what was completed in it."""

    msc: int
    t_monotonic_ns: int
    serial: int
    swap: bool


class VBlankClock:
    """Vertical blanks of the output of a window.

    Args:
        display: X display; window: id of the window that OpenGL draws to.

    Raises:
        DriverError: no connection, or the server has no Present extension.
    """

    def __init__(self, display: str, window: int) -> None:
        self._xcb, self._present, self._libc = _libraries()
        self._window = window
        self._connection = c_void_p(self._xcb.xcb_connect(display.encode(), None))
        self._serial = 0
        try:
            self._queue = self._listen(display)
        except BaseException:
            self.close()
            raise

    def _listen(self, display: str) -> c_void_p:
        if self._xcb.xcb_connection_has_error(self._connection):
            raise DriverError(f"X display {display}: no second connection")
        extension = byref(ctypes.c_char.in_dll(self._present, "xcb_present_id"))
        data = self._xcb.xcb_get_extension_data(self._connection, extension)
        if not data or not data.contents.present:
            raise DriverError(f"X display {display} has no Present extension")
        cookie = self._present.xcb_present_query_version(self._connection, 1, 2)
        self._libc.free(self._present.xcb_present_query_version_reply(self._connection, cookie, None))
        event_id = self._xcb.xcb_generate_id(self._connection)
        queue = c_void_p(self._xcb.xcb_register_for_special_xge(self._connection, extension, event_id, None))
        self._present.xcb_present_select_input(self._connection, event_id, self._window, COMPLETE_NOTIFY_MASK)
        self._xcb.xcb_flush(self._connection)
        return queue

    def fileno(self) -> int:
        """Descriptor to poll for events; call :meth:`events` afterwards."""
        return int(self._xcb.xcb_get_file_descriptor(self._connection))

    @property
    def broken(self) -> bool:
        """Whether the connection is lost."""
        return bool(self._xcb.xcb_connection_has_error(self._connection))

    def request(self, msc: int | None = None) -> int:
        """Request an event at vertical blank ``msc`` (None = the next one); return its serial."""
        self._serial = self._serial + 1 & 0xFFFFFFFF
        target, divisor = (0, 1) if msc is None else (msc, 0)
        self._present.xcb_present_notify_msc(self._connection, self._window, self._serial, target, divisor, 0)
        self._xcb.xcb_flush(self._connection)
        return self._serial

    def events(self) -> list[VBlank]:
        """Return the vertical blanks since the last call."""
        while other := self._xcb.xcb_poll_for_event(self._connection):  # this one also reads from the socket
            self._libc.free(other)
        out = []
        while pointer := self._xcb.xcb_poll_for_special_event(self._connection, self._queue):
            event = ctypes.cast(pointer, POINTER(CompleteNotify)).contents
            if event.event_type == COMPLETE_NOTIFY:
                swap = event.kind == KIND_PIXMAP
                out.append(VBlank(int(event.msc), plausible_ns(int(event.ust)), int(event.serial), swap))
            self._libc.free(pointer)
        return out

    def wait(self, timeout_s: float) -> list[VBlank]:
        """Return :meth:`events` after waiting for at least one; empty after the time-out."""
        deadline = time.monotonic() + timeout_s
        while not (events := self.events()):
            left = deadline - time.monotonic()
            if left <= 0 or self.broken or not select.select([self.fileno()], [], [], left)[0]:
                return []
        return events

    def close(self) -> None:
        """End the connection."""
        if self._connection:
            self._xcb.xcb_disconnect(self._connection)
            self._connection = c_void_p(None)


def plausible_ns(ust_us: int) -> int:
    """Return nanoseconds of CLOCK_MONOTONIC, or 0 where a server uses another clock."""
    t_ns = ust_us * 1000
    return t_ns if abs(time.monotonic_ns() - t_ns) < PLAUSIBLE_S * 1e9 else 0
