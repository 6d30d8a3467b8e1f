"""The functions of libxcb for reading an output's pixels, typed for ctypes."""

from __future__ import annotations

import ctypes
import functools
from ctypes import POINTER, Structure, c_char_p, c_int, c_int16, c_int32, c_uint, c_uint8, c_uint16, c_uint32, c_void_p
from typing import Any


class Cookie(Structure):
    """Number of a request, which identifies its reply."""

    _fields_ = (("sequence", c_uint),)


class Screen(Structure):
    """The X screen, as the server describes it when a client connects (xcb_screen_t)."""

    _fields_ = (
        ("root", c_uint32), ("default_colormap", c_uint32), ("white_pixel", c_uint32), ("black_pixel", c_uint32),
        ("current_input_masks", c_uint32), ("width", c_uint16), ("height", c_uint16), ("width_mm", c_uint16),
        ("height_mm", c_uint16), ("min_installed_maps", c_uint16), ("max_installed_maps", c_uint16),
        ("root_visual", c_uint32), ("backing_stores", c_uint8), ("save_unders", c_uint8), ("root_depth", c_uint8),
        ("allowed_depths_len", c_uint8),
    )  # fmt: skip


class Monitor(Structure):
    """One output of RandR 1.5 with its position on the screen (xcb_randr_monitor_info_t)."""

    _fields_ = (
        ("name", c_uint32), ("primary", c_uint8), ("automatic", c_uint8), ("outputs_len", c_uint16), ("x", c_int16),
        ("y", c_int16), ("width", c_uint16), ("height", c_uint16), ("width_mm", c_uint32), ("height_mm", c_uint32),
    )  # fmt: skip


class _ScreenIterator(Structure):
    _fields_ = (("data", POINTER(Screen)), ("rem", c_int), ("index", c_int))


class _MonitorIterator(Structure):
    _fields_ = (("data", POINTER(Monitor)), ("rem", c_int), ("index", c_int))


class Xcb:
    """The functions, without the prefix ``xcb_``; connections are addresses."""

    def __init__(self) -> None:
        xcb, shm, randr = (ctypes.CDLL(name) for name in ("libxcb.so.1", "libxcb-shm.so.0", "libxcb-randr.so.0"))
        libc = ctypes.CDLL(None)
        p, u8, u16, u32 = c_void_p, c_uint8, c_uint16, c_uint32
        self._connect = _typed(xcb.xcb_connect, p, c_char_p, POINTER(c_int))
        self.has_error = _typed(xcb.xcb_connection_has_error, c_int, p)
        self.disconnect = _typed(xcb.xcb_disconnect, None, p)
        self.flush = _typed(xcb.xcb_flush, c_int, p)
        self.file_descriptor = _typed(xcb.xcb_get_file_descriptor, c_int, p)
        self.generate_id = _typed(xcb.xcb_generate_id, u32, p)
        self.poll_for_reply = _typed(xcb.xcb_poll_for_reply, c_int, p, c_uint, POINTER(p), POINTER(p))
        self.request_check = _typed(xcb.xcb_request_check, p, p, Cookie)
        self.get_atom_name = _typed(xcb.xcb_get_atom_name, Cookie, p, u32)
        self._atom_name = _typed(xcb.xcb_get_atom_name_name, p, p)
        self._atom_name_length = _typed(xcb.xcb_get_atom_name_name_length, c_int, p)
        self._get_setup = _typed(xcb.xcb_get_setup, p, p)
        self._screens = _typed(xcb.xcb_setup_roots_iterator, _ScreenIterator, p)
        self.shm_attach_fd_checked = _typed(shm.xcb_shm_attach_fd_checked, Cookie, p, u32, c_int32, u8)
        self.shm_get_image = _typed(
            shm.xcb_shm_get_image, Cookie, p, u32, c_int16, c_int16, u16, u16, u32, u8, u32, u32
        )
        self.randr_get_monitors = _typed(randr.xcb_randr_get_monitors, Cookie, p, u32, u8)
        self._monitors = _typed(randr.xcb_randr_get_monitors_monitors_iterator, _MonitorIterator, p)
        self._next_monitor = _typed(randr.xcb_randr_monitor_info_next, None, POINTER(_MonitorIterator))
        self.free = _typed(libc.free, None, p)

    def connect(self, display: str) -> int:
        """A connection, never null; its error must be checked first."""
        return int(self._connect(display.encode(), ctypes.byref(c_int())))

    def screen(self, connection: int) -> Screen:
        """The first screen of a server."""
        screen: Screen = self._screens(self._get_setup(connection)).data.contents
        return screen

    def monitors(self, reply: int) -> list[Monitor]:
        """The outputs of a reply to ``randr_get_monitors``."""
        found, iterator = [], self._monitors(reply)
        while iterator.rem > 0:
            found.append(Monitor.from_buffer_copy(iterator.data.contents))
            self._next_monitor(ctypes.byref(iterator))
        return found

    def atom_name(self, reply: int) -> str:
        """The text of a reply to ``get_atom_name``."""
        return ctypes.string_at(self._atom_name(reply), self._atom_name_length(reply)).decode(errors="replace")


def _typed(function: Any, result: Any, *arguments: Any) -> Any:
    function.restype, function.argtypes = result, arguments
    return function


@functools.cache
def load() -> Xcb:
    """The libraries, opened once.

    Raises:
        OSError: one of them is missing; Debian's packages are libxcb1, libxcb-shm0 and libxcb-randr0.
    """
    return Xcb()
