"""Settings of an X display that affect the image.

``python -m daemon.apps.doctor.rig.display_process DISPLAY`` writes them as JSON.

A process of its own, because Xlib ends the process on some errors.
"""

from __future__ import annotations

import sys
from ctypes import byref, c_int, c_ubyte, c_ushort

import msgspec

from drivers.errors import DriverError


class Screen(msgspec.Struct, frozen=True):
    """Settings of an X display.

    Args:
        compositor: whether a compositing manager owns the screen.
        blank_after_s: of the screen saver, 0 = never; dpms: whether the server switches monitors off by itself.
        problem: the reason for missing settings.
    """

    compositor: bool = False
    blank_after_s: int = 0
    dpms: bool = False
    problem: str = ""


def read(display: str) -> Screen:
    """Read the settings from the server."""
    from drivers.projector.x11.xlib import Connection, catch_errors, xext

    try:
        catch_errors()
        connection = Connection(display)
    except DriverError as error:
        return Screen(problem=str(error))
    lib, handle = connection.lib, connection.handle
    number = display.rpartition(":")[2].partition(".")[2] or "0"
    owner = lib.XGetSelectionOwner(handle, connection.atom(f"_NET_WM_CM_S{number}"))
    values = [c_int() for _ in range(4)]
    lib.XGetScreenSaver(handle, *(byref(value) for value in values))
    dpms, level, enabled = False, c_ushort(), c_ubyte()
    if connection.has_extension("DPMS") and xext().DPMSCapable(handle):
        xext().DPMSInfo(handle, byref(level), byref(enabled))
        dpms = bool(enabled.value)
    connection.close()
    return Screen(bool(owner), max(values[0].value, 0), dpms)


if __name__ == "__main__":
    sys.stdout.buffer.write(msgspec.json.encode(read(sys.argv[1])))
