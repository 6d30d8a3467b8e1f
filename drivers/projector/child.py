"""The process that owns the projector's window. Started by :mod:`drivers.projector.supervisor`, never by hand.

It ends when its socket does, when its parent dies, when the X server goes, or when the window is destroyed; a watchdog
ends it when a graphics driver hangs.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import selectors
import signal
import socket
import sys
import time
from types import FrameType

from drivers.errors import DriverError, SettingRefused
from drivers.projector.messages import (
    Beat,
    Close,
    Failed,
    Opened,
    Setup,
    Show,
    receive_in_window,
    send,
    unpack_images,
)
from drivers.projector.output_setup import OutputSetup
from drivers.projector.present import VBlankClock
from drivers.projector.xlib import Connection, catch_errors

BEAT_S = 1.0
WATCHDOG_S = 30.0
PR_SET_PDEATHSIG = 1


class ParentDiedError(Exception):
    """Raised by the signal that the kernel sends when the parent is gone."""


class Child:
    """The window, its stage, and the conversation about them.

    Args:
        sock: SOCK_SEQPACKET to the driver.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._stage: OutputSetup | None = None
        self._clock: VBlankClock | None = None
        self._clock_notes: tuple[str, ...] = ()

    def run(self) -> int:
        """Open, serve until told to close; the exit status."""
        try:
            first = receive_in_window(self._sock)
            if first is None or not isinstance(first[0], Setup):
                return 2
            self._open(first[0])
            self._serve()
        except (OSError, ParentDiedError):
            self._restore()  # the driver is gone; the window goes with this process
        except DriverError as error:
            self._restore()
            self._fail(error)
            return 1
        return 0

    def _open(self, setup: Setup) -> None:
        from drivers.projector.window import PatternWindow

        catch_errors(self._lost)  # after pyglet, which would hide them
        self._x = Connection(setup.display)
        self._stage = stage = OutputSetup(self._x, setup.options, setup.gamma_before)
        self._window = PatternWindow(setup.display, stage.output)
        stage.adopt(self._window.ids)
        self._window.map()
        stage.keep_awake()
        self._start_screen(setup.display)
        if reason := stage.problem():
            raise DriverError(reason)
        notes = *stage.notes(), *self._clock_notes
        send(self._sock, Opened(output=stage.output, notes=notes, gamma_before=stage.gamma_before))

    def _start_screen(self, display: str) -> None:
        from drivers.projector.screen import Screen

        try:
            self._clock = VBlankClock(display, self._window.ids[1])
        except DriverError as error:
            self._clock_notes = (f"{error}: the times at which images are out are not verified",)
        self._screen = Screen(self._window, self._clock)
        self._window.take_events()
        self._screen.black()

    def _serve(self) -> None:
        assert self._stage is not None  # noqa: S101 - for the type checker
        problem, beat_at = "", 0.0
        with selectors.DefaultSelector() as selector:
            for number in (self._sock.fileno(), self._x.fileno(), self._window.fileno()):
                selector.register(number, selectors.EVENT_READ)
            if self._clock is not None:
                selector.register(self._clock.fileno(), selectors.EVENT_READ)
            while True:
                faulthandler.dump_traceback_later(WATCHDOG_S, exit=True)
                look = self._stage.take_events()
                if self._window.take_events():
                    self._screen.redraw()
                self._screen.take_events()
                now = time.monotonic()
                if look or now >= beat_at:
                    told, problem = problem, self._stage.problem() or self._screen.wrong_pixels
                    if told != problem or now >= beat_at:
                        self._beat(problem)
                        beat_at = now + BEAT_S
                self._x.lib.XFlush(self._x.handle)
                ready = selector.select(max(0.0, beat_at - time.monotonic()))
                if any(key.fd == self._sock.fileno() for key, _ in ready) and not self._command():
                    return

    def _beat(self, problem: str) -> None:
        try:
            send(self._sock, Beat(problem=problem, late=self._screen.late), wait=False)
        except BlockingIOError:
            return  # the driver is halted, by a debugger perhaps; it will hear the next one

    def _command(self) -> bool:
        """Do what the driver asks; False when it is time to end."""
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
        """Black, then gone, and everything as it was."""
        self._screen.black()
        self._restore()
        self._window.close()
        if self._clock is not None:
            self._clock.close()
        self._x.close()

    def _restore(self) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # nothing may interrupt it
        try:
            if self._stage is not None:
                self._stage.restore()
        except DriverError as error:
            print(error, file=sys.stderr)  # noqa: T201 - the driver reads it

    def _fail(self, error: DriverError) -> None:
        try:
            send(self._sock, Failed(reason=str(error), refused=isinstance(error, SettingRefused)))
        except OSError:
            return

    def _lost(self) -> None:
        """The X server is gone; nothing of Xlib works any more."""
        self._fail(DriverError("the X server broke the connection"))
        os._exit(1)


def _parent_died(_: int, __: FrameType | None) -> None:
    raise ParentDiedError


def main(number: str) -> int:
    """Serve the socket that was inherited under this number."""
    sock = socket.socket(fileno=int(number))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, who closes us
    signal.signal(signal.SIGTERM, _parent_died)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    faulthandler.dump_traceback_later(WATCHDOG_S, exit=True)
    return Child(sock).run()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
