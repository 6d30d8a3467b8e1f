"""The process that owns the projector's window. Started by the driver's supervisor, never by hand.

It ends with its socket, its parent, the X server or the window; a watchdog ends it when a graphics driver hangs.
"""

from __future__ import annotations

import faulthandler
import os
import selectors
import signal
import socket
import sys
import time
from types import FrameType

from drivers.child_process import set_death_signal
from drivers.errors import DriverError, SettingRefused
from drivers.projector.messages import (
    Close,
    Failed,
    Heartbeat,
    Opened,
    Setup,
    Show,
    receive_in_window,
    send,
    unpack_images,
)
from drivers.projector.window_process.output_setup import OutputSetup
from drivers.projector.x11.present import VBlankClock
from drivers.projector.x11.xlib import Connection, catch_errors

HEARTBEAT_S = 1.0
WATCHDOG_S = 30.0


class ParentDiedError(Exception):
    """Raised by the signal that the kernel sends when the parent has ended."""


class Child:
    """The window, its output, and the messages about them.

    Args:
        sock: SOCK_SEQPACKET to the driver.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._setup: OutputSetup | None = None
        self._clock: VBlankClock | None = None
        self._clock_notes: tuple[str, ...] = ()

    def run(self) -> int:
        """Open and serve until the driver closes the window; return the exit status."""
        try:
            first = receive_in_window(self._sock)
            if first is None or not isinstance(first[0], Setup):
                return 2
            self._open(first[0])
            self._serve()
        except (OSError, ParentDiedError):
            self._restore()  # the driver is gone; the window ends with this process
        except DriverError as error:
            self._restore()
            self._fail(error)
            return 1
        return 0

    def _open(self, setup: Setup) -> None:
        from drivers.projector.window_process.window import PatternWindow

        catch_errors(self._lost)  # after pyglet, which installs its own handlers
        self._x = Connection(setup.display)
        self._setup = prepared = OutputSetup(self._x, setup.options, setup.gamma_before)
        self._window = PatternWindow(setup.display, prepared.output)
        prepared.adopt(self._window.ids)
        self._window.map()
        prepared.keep_awake()
        self._start_screen(setup.display)
        if reason := prepared.problem():
            raise DriverError(reason)
        notes = *prepared.notes(), *self._clock_notes
        send(self._sock, Opened(output=prepared.output, notes=notes, gamma_before=prepared.gamma_before))

    def _start_screen(self, display: str) -> None:
        from drivers.projector.window_process.screen import Screen

        try:
            self._clock = VBlankClock(display, self._window.ids[1])
        except DriverError as error:
            self._clock_notes = (f"{error}: the times at which images are displayed are not verified",)
        self._screen = Screen(self._window, self._clock)
        self._window.take_events()
        self._screen.black()

    def _serve(self) -> None:
        assert self._setup is not None  # noqa: S101 - for the type checker
        problem, heartbeat_at = "", 0.0
        with selectors.DefaultSelector() as selector:
            for number in (self._sock.fileno(), self._x.fileno(), self._window.fileno()):
                selector.register(number, selectors.EVENT_READ)
            if self._clock is not None:
                selector.register(self._clock.fileno(), selectors.EVENT_READ)
            while True:
                faulthandler.dump_traceback_later(WATCHDOG_S, exit=True)
                changed = self._setup.take_events()
                if self._window.take_events():
                    self._screen.redraw()
                self._screen.take_events()
                now = time.monotonic()
                if changed or now >= heartbeat_at:
                    reported, problem = problem, self._setup.problem() or self._screen.wrong_pixels
                    if reported != problem or now >= heartbeat_at:
                        self._heartbeat(problem)
                        heartbeat_at = now + HEARTBEAT_S
                self._x.lib.XFlush(self._x.handle)
                ready = selector.select(max(0.0, heartbeat_at - time.monotonic()))
                if any(key.fd == self._sock.fileno() for key, _ in ready) and not self._command():
                    return

    def _heartbeat(self, problem: str) -> None:
        try:
            send(self._sock, Heartbeat(problem=problem, late=self._screen.late), wait=False)
        except BlockingIOError:
            return  # the driver is halted, by a debugger for example; it will receive the next one

    def _command(self) -> bool:
        """Execute a command of the driver; False at the end."""
        received = receive_in_window(self._sock)
        if received is None:
            self._finish()
            return False
        message, memfd = received
        if isinstance(message, Show) and memfd is not None:
            shown = self._screen.show(unpack_images(memfd, message), message)
            send(self._sock, shown)
            return True
        if memfd is not None:
            os.close(memfd)
        if isinstance(message, Close):
            self._finish()
            return False
        return True

    def _finish(self) -> None:
        """Go dark, restore everything and close the window."""
        self._screen.black()
        self._restore()
        self._window.close()
        if self._clock is not None:
            self._clock.close()
        self._x.close()

    def _restore(self) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # nothing may interrupt it
        try:
            if self._setup is not None:
                self._setup.restore()
        except DriverError as error:
            print(error, file=sys.stderr)  # noqa: T201 - the driver reads it

    def _fail(self, error: DriverError) -> None:
        try:
            send(self._sock, Failed(reason=str(error), refused=isinstance(error, SettingRefused)))
        except OSError:
            return

    def _lost(self) -> None:
        """Report the loss of the X server and end: Xlib cannot be used any more."""
        self._fail(DriverError("the X server broke the connection"))
        os._exit(1)


def _parent_died(_: int, __: FrameType | None) -> None:
    raise ParentDiedError


def main(number: str) -> int:
    """Serve the socket that was inherited under this number."""
    sock = socket.socket(fileno=int(number))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, who closes us
    signal.signal(signal.SIGTERM, _parent_died)
    set_death_signal(signal.SIGTERM)
    faulthandler.dump_traceback_later(WATCHDOG_S, exit=True)
    return Child(sock).run()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
