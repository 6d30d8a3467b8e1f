"""Set-up of output and window: geometry, stacking, gamma, screen saver; all of it verified."""

from __future__ import annotations

from ctypes import byref, c_int, c_ubyte, c_ushort

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError, SettingRefused
from drivers.projector.options import ProjectorOptions
from drivers.projector.x11 import xlib
from drivers.projector.x11.detected_output import DetectedOutput, gamma_problem, mode_problem, output_problem
from drivers.projector.x11.randr import Randr, identity
from drivers.projector.x11.xlib import Connection

GAMMA_BYTES_LIMIT = 3 * 2 * 4096
"""Larger tables are not passed on, so they are not restored when this process is killed."""


class OutputSetup:
    """One output, set up for images that must be displayed pixel by pixel.

    Args:
        connection: to the X server; options: requirements on the output.
        gamma_before: the table to restore at the end, if an earlier process has changed it.

    Raises:
        DriverError: no such output, or it is off. SettingRefused: it changes pixels or their values.
    """

    def __init__(self, connection: Connection, options: ProjectorOptions, gamma_before: bytes = b"") -> None:
        self._x, self._options = connection, options
        if connection.has_extension("XWAYLAND"):
            raise SettingRefused(
                f"X display {connection.name} is XWayland, which does not own the outputs; log in to an X11 session, "
                "or run an X server of the rig's own"
            )
        self.randr = Randr(connection)
        self._windows: tuple[int, int] | None = None
        self.gamma_before = gamma_before
        self.output = self._fit_output()
        self._linearize()
        self.randr.watch()
        self._dpms_was_on = False
        self._saver_before = tuple(c_int() for _ in range(4))
        self._visibility = 0
        self._destroyed = False

    def notes(self) -> tuple[str, ...]:
        """Return what may change the image and cannot be verified."""
        notes = [f"output {self.output.name}: {note}" for note in self.output.notes]
        if self._options.mode == "native" and self.output.preferred_size is None:
            notes.append(f"output {self.output.name} reports no native resolution, so its mode was not checked")
        if self.output.gamma_identity is None:
            notes.append(f"output {self.output.name} has no gamma table to check")
        if self.gamma_before:
            notes.append(f"output {self.output.name} had a gamma table that was not linear; it is, until close")
        if self._x.lib.XGetSelectionOwner(self._x.handle, self._x.atom("_NET_WM_CM_S0")):
            notes.append("a compositor runs on this display; it can delay images by a frame")
        return tuple(notes)

    def keep_awake(self) -> None:
        """Disable screen saver and DPMS, where the server has them."""
        lib, handle = self._x.lib, self._x.handle
        lib.XGetScreenSaver(handle, *(byref(value) for value in self._saver_before))
        timeout, interval, blanking, exposures = (value.value for value in self._saver_before)
        if timeout:
            lib.XSetScreenSaver(handle, 0, interval, blanking, exposures)
        lib.XResetScreenSaver(handle)
        if self._has_dpms():
            self._dpms_was_on = self._dpms()[1]
            xlib.xext().DPMSForceLevel(handle, xlib.DPMS_ON)
            xlib.xext().DPMSDisable(handle)
        self._x.sync()

    def adopt(self, windows: tuple[int, int]) -> None:
        """Exclude a hidden window (outer, inner) from window management and place it on the output."""
        self._windows = windows
        attributes = xlib.XSetWindowAttributes(override_redirect=1)
        self._x.lib.XChangeWindowAttributes(self._x.handle, windows[0], xlib.CW_OVERRIDE_REDIRECT, byref(attributes))
        self._x.lib.XSelectInput(self._x.handle, windows[0], xlib.VISIBILITY_CHANGE | xlib.STRUCTURE_NOTIFY)
        self._place_window()

    def take_events(self) -> bool:
        """Handle the connection's events; return whether anything changed that :meth:`problem` should check."""
        events = self._x.events()
        for event in events:
            if event.type == xlib.VISIBILITY_NOTIFY:
                self._visibility = event.visibility.state
            elif event.type == xlib.DESTROY_NOTIFY:
                self._destroyed = True
        return bool(events)

    def problem(self) -> str:
        """Check everything again and correct what is possible; return why the image is not right, empty if it is.

        Raises:
            DriverError: the window was destroyed.
        """
        self.take_events()
        try:
            output = self._fit_output()
        except DriverError as error:
            return str(error)
        self.output = output
        return self._check_placement() or self._check_power()

    def restore(self) -> None:
        """Restore gamma table and screen saver."""
        crtc = self.randr.crtc_of(self._options.output)
        if crtc and self.gamma_before:
            before = np.frombuffer(self.gamma_before, np.uint16).reshape(3, -1)
            now = self.randr.gamma(crtc)
            if now is not None and now.shape == before.shape:
                self.randr.set_gamma(crtc, before)
        if self._saver_before[0].value:
            self._x.lib.XSetScreenSaver(self._x.handle, *(value.value for value in self._saver_before))
        if self._dpms_was_on:
            xlib.xext().DPMSEnable(self._x.handle)
        self._x.sync()

    def _fit_output(self) -> DetectedOutput:
        options = self._options
        output = self.randr.output(options.output)
        if output is None or not output.is_on:
            raise DriverError(output_problem(self.randr.outputs(), options.output))
        refused = mode_problem(
            output, native=options.mode == "native", size=options.size, refresh_hz=options.refresh_hz
        )
        if not refused and output.gamma_identity is False:
            if options.gamma == "check":
                refused = gamma_problem(output)
            elif self._windows is not None:  # another program has loaded its table again
                self._make_linear()
        if refused:
            raise SettingRefused(refused)
        return output

    def _linearize(self) -> None:
        if self._options.gamma != "reset":
            return
        if self.output.gamma_identity is False:
            before = self._make_linear()
            if not self.gamma_before and before is not None and before.nbytes <= GAMMA_BYTES_LIMIT:
                self.gamma_before = before.tobytes()
        again = self.randr.output(self._options.output)
        if again is not None and (reason := gamma_problem(again)):
            raise SettingRefused(f"{reason}; it could not be reset")

    def _make_linear(self) -> NDArray[np.uint16] | None:
        """Load the linear gamma table; return the previous one."""
        crtc = self.randr.crtc_of(self._options.output)
        before = self.randr.gamma(crtc)
        if before is not None:
            self.randr.set_gamma(crtc, identity(before.shape[1]))
        return before

    def _check_placement(self) -> str:
        if self._windows is None:
            return ""
        if self._geometry() != self._rectangle():
            self._place_window()
            now = self._geometry()
            if now != self._rectangle():
                return f"another program moves the window: {now} (x, y, width, height), not {self._rectangle()}"
        if self._visibility:
            self._x.lib.XRaiseWindow(self._x.handle, self._windows[0])
            self._x.sync()
            self.take_events()
            if self._visibility:
                return f"another window covers the image on output {self.output.name}"
        return ""

    def _place_window(self) -> None:
        assert self._windows is not None  # noqa: S101 - for the type checker
        x, y, width, height = self._rectangle()
        self._x.lib.XMoveResizeWindow(self._x.handle, self._windows[0], x, y, width, height)
        self._x.lib.XRaiseWindow(self._x.handle, self._windows[0])
        self._x.sync()

    def _rectangle(self) -> tuple[int, int, int, int]:
        return *self.output.position, *self.output.size

    def _geometry(self) -> tuple[int, int, int, int]:
        """Return the rectangle of the inner window on the X screen from the server."""
        assert self._windows is not None  # noqa: S101 - for the type checker
        lib, handle, (outer, inner) = self._x.lib, self._x.handle, self._windows
        frame, image = xlib.XWindowAttributes(), xlib.XWindowAttributes()
        read = lib.XGetWindowAttributes(handle, outer, byref(frame))
        if self._destroyed or not read or not lib.XGetWindowAttributes(handle, inner, byref(image)):
            raise DriverError("the projector's window was destroyed by another program")
        if frame.map_state != xlib.IS_VIEWABLE or image.map_state != xlib.IS_VIEWABLE:
            raise DriverError("the projector's window was taken off the screen by another program")
        x, y, child = c_int(), c_int(), xlib.XID()
        lib.XTranslateCoordinates(handle, inner, self._x.root, 0, 0, byref(x), byref(y), byref(child))
        if (image.width, image.height) != (frame.width, frame.height):
            return x.value, y.value, frame.width, frame.height
        return x.value, y.value, image.width, image.height

    def _check_power(self) -> str:
        if not self._has_dpms():
            return ""
        level, enabled = self._dpms()
        if enabled and level != xlib.DPMS_ON:
            xlib.xext().DPMSForceLevel(self._x.handle, xlib.DPMS_ON)
            self._x.sync()
            return f"output {self.output.name} was asleep (DPMS) and has been woken"
        return ""

    def _has_dpms(self) -> bool:
        if not self._x.has_extension("DPMS"):
            return False
        return bool(xlib.xext().DPMSCapable(self._x.handle))

    def _dpms(self) -> tuple[int, bool]:
        level, enabled = c_ushort(), c_ubyte()
        xlib.xext().DPMSInfo(self._x.handle, byref(level), byref(enabled))
        return level.value, bool(enabled.value)
