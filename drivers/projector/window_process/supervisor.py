"""Supervision of a projector's window: its process is started, given the requested image, and restarted when it dies.

The supervisor's thread reconciles the requested image with the one that was sent to the window::

    starting --Opened--> up --EOF, silence--> down --back-off--> starting
                          |  requested != sent -> Show;  Shown -> displayed
"""

from __future__ import annotations

import contextlib
import logging
import os
import selectors
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError, SettingRefused
from drivers.projector.messages import (
    Close,
    Failed,
    Heartbeat,
    Opened,
    Setup,
    Show,
    Shown,
    pack_images,
    receive_from_window,
    send,
)
from drivers.projector.window_process.process import WindowProcess

log = logging.getLogger("fringed.projector")

OPEN_S = 30.0
CLOSE_S = 5.0
BACKOFF_S = 0.1, 5.0
STEADY_S = 10.0


@dataclass(slots=True)
class _State:
    """State shared by the thread and its callers, under one lock."""

    opened: Opened | None = None
    failed: Failed | None = None
    shown: Shown | None = None
    requested: Show | None = None
    memfd: int = -1
    down: str = ""
    heartbeat: Heartbeat = field(default_factory=Heartbeat)
    after_show: str = ""
    restarts: int = 0
    pid: int = 0
    closing: bool = False
    ended: bool = False


class Supervisor:
    """Keeps the window of one projector running.

    Args:
        setup: what to open.
        after_show: called in the supervisor's thread after each displayed image; DriverError becomes a problem.
        hung_s: silence after which the window's process counts as hung; its heartbeat comes once a second.
    """

    def __init__(self, setup: Setup, *, after_show: Callable[[], None], hung_s: float = 6.0) -> None:
        self._setup = setup
        self._after_show = after_show
        self._hung_s = hung_s
        self._state = _State()
        self._changed = threading.Condition()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="projector", daemon=True)

    def open(self) -> Opened:
        """Start and return the properties of the window; SettingRefused or DriverError if there is none."""
        self._thread.start()
        with self._changed:
            self._changed.wait_for(lambda: self._state.opened or self._state.ended)
            opened, failed = self._state.opened, self._state.failed
        if opened is None:
            self.close()
            reason = failed or Failed(reason="the projector's window could not be opened")
            raise (SettingRefused if reason.refused else DriverError)(f"projector: {reason.reason}")
        return opened

    def show(self, images: list[NDArray[np.uint8]], *, hold_frames: int, loop: bool, timeout_s: float) -> Shown | None:
        """Request these images; return when the first one is displayed, None if that takes too long."""
        height, width = images[0].shape[:2]
        memfd = pack_images(images)
        with self._changed:
            old, last = self._state.memfd, self._state.requested
            serial = last.serial + 1 if last is not None else 1
            sizes = {"count": len(images), "width": width, "height": height}
            self._state.requested = Show(serial=serial, hold_frames=hold_frames, loop=loop, **sizes)
            self._state.memfd = memfd
            if old >= 0:
                os.close(old)
            self._wake_thread()
            self._changed.wait_for(lambda: self._is_displayed(serial) or self._state.ended, timeout_s)
            return self._state.shown if self._is_displayed(serial) else None

    def problem(self) -> str:
        """Return why the requested image may not be displayed, empty when it is."""
        with self._changed:
            state = self._state
            if state.down or state.heartbeat.problem:
                return state.down or state.heartbeat.problem
            if state.requested is not None and not self._is_displayed(state.requested.serial):
                return "the display of the image is not confirmed yet"
            return state.after_show

    def counted(self) -> dict[str, int]:
        """Return the restarts of the window and the late images of sequences."""
        with self._changed:
            return {"restarts": self._state.restarts, "late": self._state.heartbeat.late}

    @property
    def pid(self) -> int:
        """Process id of the window, 0 while there is none."""
        with self._changed:
            return self._state.pid

    def close(self) -> None:
        """Go dark, end the process and the thread; may be called twice."""
        with self._changed:
            self._state.closing = True
            self._changed.notify_all()
            if self._wake >= 0:
                self._wake_thread()
        if self._thread.is_alive():
            self._thread.join()
        with self._changed:
            for descriptor in (self._wake, self._state.memfd):
                if descriptor >= 0:
                    os.close(descriptor)
            self._wake = self._state.memfd = -1

    def _is_displayed(self, serial: int) -> bool:
        return self._state.shown is not None and self._state.shown.serial == serial

    def _wake_thread(self) -> None:
        os.eventfd_write(self._wake, 1)

    def _run(self) -> None:
        delay_s = BACKOFF_S[0]
        try:
            while True:
                started = time.monotonic()
                failed = self._run_window()
                with self._changed:
                    self._set_down(failed)
                    if self._state.closing or self._state.opened is None:
                        return
                    if time.monotonic() - started > STEADY_S:
                        delay_s = BACKOFF_S[0]
                    if self._changed.wait_for(lambda: self._state.closing, delay_s):
                        return
                    self._state.restarts += 1
                delay_s = min(2 * delay_s, BACKOFF_S[1])
        finally:
            with self._changed:
                self._state.ended = True
                self._changed.notify_all()

    def _set_down(self, failed: Failed) -> None:
        state = self._state
        state.pid, state.shown, state.failed = 0, None, failed
        state.down = f"no image, the window is restarted: {failed.reason}"
        state.heartbeat = msgspec.structs.replace(state.heartbeat, problem="")

    def _run_window(self) -> Failed:
        """Run the window's process once, from start to end; return why it ended."""
        try:
            window = WindowProcess()
        except OSError as error:
            return Failed(reason=f"the window's process cannot be started: {error}")
        with self._changed:
            self._state.pid = window.pid
        run = _WindowRun(window)
        try:
            send(window.sock, self._setup)
            self._exchange(run)
        except ConnectionError:  # it ended before a message was sent; its last messages are still to be read
            with contextlib.suppress(OSError, msgspec.DecodeError):
                while self._receive(run):
                    pass
        except (OSError, ValueError, msgspec.DecodeError) as error:
            run.failed = run.failed or Failed(reason=f"the window's process: {error}")
            window.kill()
        except Exception as error:  # a defect here ends one window process, not the supervision
            log.exception("the exchange with the window failed")
            run.failed = run.failed or Failed(reason=f"{type(error).__name__}: {error}")
            window.kill()
        ending = window.end(CLOSE_S if run.failed is None else 1.0)
        return run.failed or Failed(reason=f"the window's process ended: {ending}")

    def _exchange(self, run: _WindowRun) -> None:
        window = run.window
        with selectors.DefaultSelector() as selector:
            for source in (window.sock, window.stderr, self._wake):
                selector.register(source, selectors.EVENT_READ)
            while True:
                self._send_pending(run)
                ready = {key.fileobj for key, _ in selector.select(max(0.0, run.deadline_s - time.monotonic()))}
                if self._wake in ready:
                    os.eventfd_read(self._wake)
                if window.stderr in ready and not window.listen():
                    selector.unregister(window.stderr)
                if window.sock in ready:
                    if not self._receive(run):
                        return
                elif time.monotonic() > run.deadline_s:
                    run.failed = Failed(reason="the window's process does not answer")
                    window.kill()
                    return

    def _send_pending(self, run: _WindowRun) -> None:
        """Send the requested images, or the close message, if they were not sent yet."""
        with self._changed:
            if self._state.closing:
                if not run.closing:
                    run.closing = True
                    run.deadline_s = time.monotonic() + CLOSE_S
                    send(run.window.sock, Close())
                return
            requested = self._state.requested
            if run.opened and requested is not None and requested.serial != run.sent_serial:
                send(run.window.sock, requested, self._state.memfd)
                run.sent_serial = requested.serial

    def _receive(self, run: _WindowRun) -> bool:
        """Receive one message; False at the end."""
        message = receive_from_window(run.window.sock)
        if message is None:
            return False
        if not run.closing:
            run.deadline_s = time.monotonic() + self._hung_s
        if isinstance(message, Shown):
            self._image_shown(run, message)
        with self._changed:
            if isinstance(message, Opened):
                run.opened = True
                self._state.opened = message
                self._setup = msgspec.structs.replace(self._setup, gamma_before=message.gamma_before)
                if self._state.requested is None:
                    self._state.down = ""
            elif isinstance(message, Heartbeat):
                self._state.heartbeat = message
            elif isinstance(message, Failed):
                run.failed = message
            self._changed.notify_all()
        return True

    def _image_shown(self, run: _WindowRun, shown: Shown) -> None:
        after_show = ""
        try:
            self._after_show()
        except DriverError as error:
            after_show = str(error)
        if not run.closing:
            run.deadline_s = time.monotonic() + self._hung_s
        with self._changed:
            requested = self._state.requested
            self._state.shown, self._state.after_show = shown, after_show
            if requested is not None and requested.serial == shown.serial:
                self._state.down = ""


@dataclass(slots=True)
class _WindowRun:
    """One process of the window and the state of the exchange with it."""

    window: WindowProcess
    opened: bool = False
    sent_serial: int = 0
    closing: bool = False
    failed: Failed | None = None
    deadline_s: float = 0.0

    def __post_init__(self) -> None:
        self.deadline_s = time.monotonic() + OPEN_S
