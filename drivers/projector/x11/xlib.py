"""The parts of libX11 and libXext that the projector needs, by ctypes; X errors become exceptions.

Xlib ends the process on the first error by default, therefore this module is only used in a process of its own
(:mod:`drivers.projector.window_process.child`, :mod:`drivers.projector.x11.listing`).
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable
from ctypes import POINTER, Structure, byref, c_char_p, c_int, c_long, c_uint, c_ulong, c_ushort, c_void_p
from functools import cache
from typing import Any

from drivers.errors import DriverError

XID = c_ulong
VISIBILITY_CHANGE = 1 << 16
STRUCTURE_NOTIFY = 1 << 17
IS_VIEWABLE = 2
DPMS_ON = 0
VISIBILITY_NOTIFY, DESTROY_NOTIFY, UNMAP_NOTIFY = 15, 17, 18


class XErrorEvent(Structure):
    """As in Xlib.h."""

    _fields_ = (
        ("type", c_int),
        ("display", c_void_p),
        ("resource", XID),
        ("serial", c_ulong),
        ("error_code", ctypes.c_ubyte),
        ("request_code", ctypes.c_ubyte),
        ("minor_code", ctypes.c_ubyte),
    )


class XWindowAttributes(Structure):
    """As in Xlib.h."""

    _fields_ = (
        ("x", c_int),
        ("y", c_int),
        ("width", c_int),
        ("height", c_int),
        ("border_width", c_int),
        ("depth", c_int),
        ("visual", c_void_p),
        ("root", XID),
        ("window_class", c_int),
        ("bit_gravity", c_int),
        ("win_gravity", c_int),
        ("backing_store", c_int),
        ("backing_planes", c_ulong),
        ("backing_pixel", c_ulong),
        ("save_under", c_int),
        ("colormap", XID),
        ("map_installed", c_int),
        ("map_state", c_int),
        ("all_event_masks", c_long),
        ("your_event_mask", c_long),
        ("do_not_propagate_mask", c_long),
        ("override_redirect", c_int),
        ("screen", c_void_p),
    )


class XSetWindowAttributes(Structure):
    """As in X.h; only ``override_redirect`` is used."""

    _fields_ = (
        ("background_pixmap", XID),
        ("background_pixel", c_ulong),
        ("border_pixmap", XID),
        ("border_pixel", c_ulong),
        ("bit_gravity", c_int),
        ("win_gravity", c_int),
        ("backing_store", c_int),
        ("backing_planes", c_ulong),
        ("backing_pixel", c_ulong),
        ("save_under", c_int),
        ("event_mask", c_long),
        ("do_not_propagate_mask", c_long),
        ("override_redirect", c_int),
        ("colormap", XID),
        ("cursor", XID),
    )


CW_OVERRIDE_REDIRECT = 1 << 9


class XVisibilityEvent(Structure):
    """As in Xlib.h; also the beginning of every other event about a window."""

    _fields_ = (
        ("type", c_int),
        ("serial", c_ulong),
        ("send_event", c_int),
        ("display", c_void_p),
        ("window", XID),
        ("state", c_int),
    )


class XEvent(ctypes.Union):
    """As in Xlib.h."""

    _fields_ = (("type", c_int), ("visibility", XVisibilityEvent), ("pad", c_long * 24))


ERROR_HANDLER = ctypes.CFUNCTYPE(c_int, c_void_p, POINTER(XErrorEvent))
IO_ERROR_HANDLER = ctypes.CFUNCTYPE(c_int, c_void_p)

SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "XOpenDisplay": (c_void_p, (c_char_p,)),
    "XCloseDisplay": (c_int, (c_void_p,)),
    "XConnectionNumber": (c_int, (c_void_p,)),
    "XDefaultRootWindow": (XID, (c_void_p,)),
    "XSync": (c_int, (c_void_p, c_int)),
    "XFlush": (c_int, (c_void_p,)),
    "XPending": (c_int, (c_void_p,)),
    "XNextEvent": (c_int, (c_void_p, POINTER(XEvent))),
    "XFree": (c_int, (c_void_p,)),
    "XSetErrorHandler": (c_void_p, (ERROR_HANDLER,)),
    "XSetIOErrorHandler": (c_void_p, (IO_ERROR_HANDLER,)),
    "XGetErrorText": (c_int, (c_void_p, c_int, c_char_p, c_int)),
    "XInternAtom": (XID, (c_void_p, c_char_p, c_int)),
    "XGetAtomName": (c_void_p, (c_void_p, XID)),
    "XGetSelectionOwner": (XID, (c_void_p, XID)),
    "XQueryExtension": (c_int, (c_void_p, c_char_p, POINTER(c_int), POINTER(c_int), POINTER(c_int))),
    "XSelectInput": (c_int, (c_void_p, XID, c_long)),
    "XGetWindowAttributes": (c_int, (c_void_p, XID, POINTER(XWindowAttributes))),
    "XChangeWindowAttributes": (c_int, (c_void_p, XID, c_ulong, POINTER(XSetWindowAttributes))),
    "XTranslateCoordinates": (c_int, (c_void_p, XID, XID, c_int, c_int, POINTER(c_int), POINTER(c_int), POINTER(XID))),
    "XMoveResizeWindow": (c_int, (c_void_p, XID, c_int, c_int, c_uint, c_uint)),
    "XRaiseWindow": (c_int, (c_void_p, XID)),
    "XGetScreenSaver": (c_int, (c_void_p, *(POINTER(c_int),) * 4)),
    "XSetScreenSaver": (c_int, (c_void_p, *(c_int,) * 4)),
    "XResetScreenSaver": (c_int, (c_void_p,)),
}
DPMS_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "DPMSQueryExtension": (c_int, (c_void_p, POINTER(c_int), POINTER(c_int))),
    "DPMSCapable": (c_int, (c_void_p,)),
    "DPMSInfo": (c_int, (c_void_p, POINTER(c_ushort), POINTER(ctypes.c_ubyte))),
    "DPMSEnable": (c_int, (c_void_p,)),
    "DPMSDisable": (c_int, (c_void_p,)),
    "DPMSForceLevel": (c_int, (c_void_p, c_ushort)),
}


class XError(DriverError):
    """The X server refused a request."""


def load(name: str, signatures: dict[str, tuple[Any, tuple[Any, ...]]]) -> ctypes.CDLL:
    """Load a shared library and declare its functions; DriverError names a missing library."""
    try:
        library = ctypes.CDLL(name)
    except OSError as error:
        raise DriverError(
            f"the X library {name} is missing ({error}); see docs/how-to/projector.md for the packages"
        ) from None
    for function, (result, arguments) in signatures.items():
        entry = getattr(library, function)
        entry.restype, entry.argtypes = result, arguments
    return library


@cache
def x11() -> ctypes.CDLL:
    """The library libX11."""
    return load("libX11.so.6", SIGNATURES)


@cache
def xext() -> ctypes.CDLL:
    """The library libXext, for DPMS."""
    return load("libXext.so.6", DPMS_SIGNATURES)


_errors: dict[int, list[str]] = {}
"""Errors since the last sync, by the address of the connection's Display."""
ERRORS_LIMIT = 100


def _on_error(display: Any, event: Any) -> int:
    text = ctypes.create_string_buffer(128)
    x11().XGetErrorText(display, event.contents.error_code, text, len(text))
    message = text.value.decode(errors="replace")
    of_display = _errors.setdefault(int(display or 0), [])
    if len(of_display) < ERRORS_LIMIT:
        of_display.append(f"{message} (request {event.contents.request_code}.{event.contents.minor_code})")
    return 0


_handlers: list[Any] = []
"""Xlib keeps only the pointers of callbacks."""


def catch_errors(on_lost: Callable[[], None] | None = None) -> None:
    """Collect X errors of all connections of this process from now on.

    Args:
        on_lost: called when a connection breaks; Xlib ends the process when it returns.
    """
    _handlers.append(ERROR_HANDLER(_on_error))
    x11().XSetErrorHandler(_handlers[-1])
    if on_lost is not None:
        _handlers.append(IO_ERROR_HANDLER(lambda _: on_lost() or 0))
        x11().XSetIOErrorHandler(_handlers[-1])


class Connection:
    """A connection to an X server. Call :func:`catch_errors` first.

    Raises:
        DriverError: no such server, or it refuses the connection.
    """

    def __init__(self, display: str) -> None:
        self.lib = x11()
        self.handle = c_void_p(self.lib.XOpenDisplay(display.encode()))
        if not self.handle:
            raise DriverError(
                f"X display {display}: no connection; is the X server running, and may this user use it "
                "(xhost +si:localuser:NAME, or XAUTHORITY)?"
            )
        self.name = display
        self.root: int = self.lib.XDefaultRootWindow(self.handle)

    def fileno(self) -> int:
        """Descriptor to poll for events."""
        return int(self.lib.XConnectionNumber(self.handle))

    def sync(self) -> None:
        """Wait until the server has executed all requests; XError if it refused one since the last call."""
        self.lib.XSync(self.handle, 0)
        errors = _errors.pop(self.handle.value or 0, None)
        if errors:
            raise XError(f"X display {self.name}: {'; '.join(errors[:3])}")

    def close(self) -> None:
        """End the connection."""
        if self.handle:
            self.lib.XCloseDisplay(self.handle)
            self.handle = c_void_p(None)

    def atom(self, name: str) -> int:
        """Return the atom of that name."""
        return int(self.lib.XInternAtom(self.handle, name.encode(), 0))

    def atom_name(self, atom: int) -> str:
        """Return the name of an atom."""
        pointer = self.lib.XGetAtomName(self.handle, atom)
        if not pointer:
            return ""
        name = ctypes.cast(pointer, c_char_p).value or b""
        self.lib.XFree(pointer)
        return name.decode(errors="replace")

    def has_extension(self, name: str) -> bool:
        """Return whether the server has an extension."""
        numbers = c_int(), c_int(), c_int()
        return bool(self.lib.XQueryExtension(self.handle, name.encode(), *(byref(n) for n in numbers)))

    def events(self) -> list[XEvent]:
        """Return the events since the last call."""
        out = []
        while self.lib.XPending(self.handle):
            event = XEvent()
            self.lib.XNextEvent(self.handle, byref(event))
            out.append(event)
        return out
