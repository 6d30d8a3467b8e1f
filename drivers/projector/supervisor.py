"""Keeps a projector's window alive: starts its process, hands it the wanted image, starts it again when it dies.

The thread of the supervisor reconciles two things, what is wanted and what the window was told::

    starting --Opened--> up --EOF, silence--> down --back-off--> starting
                          |  wanted != told -> Show;  Shown -> all is well
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
    Beat,
    Close,
    Failed,
    Opened,
    Setup,
    Show,
    Shown,
    pack_images,
    receive_from_window,
    send,
)
from drivers.projector.process import WindowProcess

log = logging.getLogger("fringed.projector")

OPEN_S = 30.0
CLOSE_S = 5.0
BACKOFF_S = 0.1, 5.0
STEADY_S = 10.0


@dataclass(slots=True)
class _State:
    """What the thread and its callers share, under one lock."""

    opened: Opened | None = None
    failed: Failed | None = None
    shown: Shown | None = None
    wanted: Show | None = None
    memfd: int = -1
    down: str = ""
    beat: Beat = field(default_factory=Beat)
    after_show: str = ""
    restarts: int = 0
    pid: int = 0
    closing: bool = False
    ended: bool = False


class Supervisor:
    """The window of one projector, alive as far as that is possible.

    Args:
        setup: what to open.
        after_show: called in the supervisor's thread each time that an image is out; DriverError becomes a problem.
        hung_s: silence after which the window's process is taken for hung; it speaks once a second.
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
        """Start; what the window says of itself. SettingRefused or DriverError if there is no window."""
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
        """Want these images from now on; when the first one was out, or None if that took too long."""
        height, width = images[0].shape[:2]
        memfd = pack_images(images)
        with self._changed:
            old, last = self._state.memfd, self._state.wanted
            serial = last.serial + 1 if last is not None else 1
            sizes = {"count": len(images), "width": width, "height": height}
            self._state.wanted = Show(serial=serial, hold_frames=hold_frames, loop=loop, **sizes)
            self._state.memfd = memfd
            if old >= 0:
                os.close(old)
            self._nudge()
            self._changed.wait_for(lambda: self._is_out(serial) or self._state.ended, timeout_s)
            return self._state.shown if self._is_out(serial) else None

    def problem(self) -> str:
        """Why the wanted image may not be out; empty when all is well."""
        with self._changed:
            state = self._state
            if state.down or state.beat.problem:
                return state.down or state.beat.problem
            if state.wanted is not None and not self._is_out(state.wanted.serial):
                return "the image is not confirmed to be out yet"
            return state.after_show

    def counted(self) -> dict[str, int]:
        """How often the window was started again, and how many images of sequences were late."""
        with self._changed:
            return {"restarts": self._state.restarts, "late": self._state.beat.late}

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
                self._nudge()
        if self._thread.is_alive():
            self._thread.join()
        with self._changed:
            for descriptor in (self._wake, self._state.memfd):
                if descriptor >= 0:
                    os.close(descriptor)
            self._wake = self._state.memfd = -1

    def _is_out(self, serial: int) -> bool:
        return self._state.shown is not None and self._state.shown.serial == serial

    def _nudge(self) -> None:
        os.eventfd_write(self._wake, 1)

    def _run(self) -> None:
        delay_s = BACKOFF_S[0]
        try:
            while True:
                started = time.monotonic()
                failed = self._live()
                with self._changed:
                    self._fell(failed)
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

    def _fell(self, failed: Failed) -> None:
        state = self._state
        state.pid, state.shown, state.failed = 0, None, failed
        state.down = f"no image, the window is started again: {failed.reason}"
        state.beat = replace_problem(state.beat, "")

    def _live(self) -> Failed:
        """One life of the window's process, from start to end; why it ended."""
        try:
            window = WindowProcess()
        except OSError as error:
            return Failed(reason=f"the window's process cannot be started: {error}")
        with self._changed:
            self._state.pid = window.pid
        life = _Life(window)
        try:
            send(window.sock, self._setup)
            self._converse(life)
        except ConnectionError:  # it ended before it was told something; its last words are still to be read
            with contextlib.suppress(OSError, msgspec.DecodeError):
                while self._hear(life):
                    pass
        except (OSError, ValueError, msgspec.DecodeError) as error:
            life.failed = life.failed or Failed(reason=f"the window's process: {error}")
            window.kill()
        except Exception as error:  # a defect of ours costs one window, not the light for good
            log.exception("the conversation with the window failed")
            life.failed = life.failed or Failed(reason=f"{type(error).__name__}: {error}")
            window.kill()
        how = window.end(CLOSE_S if life.failed is None else 1.0)
        return life.failed or Failed(reason=f"the window's process ended: {how}")

    def _converse(self, life: _Life) -> None:
        window = life.window
        with selectors.DefaultSelector() as selector:
            for source in (window.sock, window.stderr, self._wake):
                selector.register(source, selectors.EVENT_READ)
            while True:
                self._tell(life)
                ready = {key.fileobj for key, _ in selector.select(max(0.0, life.patience_until - time.monotonic()))}
                if self._wake in ready:
                    os.eventfd_read(self._wake)
                if window.stderr in ready and not window.listen():
                    selector.unregister(window.stderr)
                if window.sock in ready:
                    if not self._hear(life):
                        return
                elif time.monotonic() > life.patience_until:
                    life.failed = Failed(reason="the window's process does not answer")
                    window.kill()
                    return

    def _tell(self, life: _Life) -> None:
        """Tell the window what is wanted, where it was not told yet."""
        with self._changed:
            if self._state.closing:
                if not life.closing:
                    life.closing = True
                    life.patience_until = time.monotonic() + CLOSE_S
                    send(life.window.sock, Close())
                return
            wanted = self._state.wanted
            if life.opened and wanted is not None and wanted.serial != life.told:
                send(life.window.sock, wanted, self._state.memfd)
                life.told = wanted.serial

    def _hear(self, life: _Life) -> bool:
        """Take one message; False at the end."""
        message = receive_from_window(life.window.sock)
        if message is None:
            return False
        if not life.closing:
            life.patience_until = time.monotonic() + self._hung_s
        if isinstance(message, Shown):
            self._after(life, message)
        with self._changed:
            if isinstance(message, Opened):
                life.opened = True
                self._state.opened = message
                self._setup = replace_gamma(self._setup, message.gamma_before)
                if self._state.wanted is None:
                    self._state.down = ""
            elif isinstance(message, Beat):
                self._state.beat = message
            elif isinstance(message, Failed):
                life.failed = message
            self._changed.notify_all()
        return True

    def _after(self, life: _Life, shown: Shown) -> None:
        after_show = ""
        try:
            self._after_show()
        except DriverError as error:
            after_show = str(error)
        if not life.closing:
            life.patience_until = time.monotonic() + self._hung_s
        with self._changed:
            wanted = self._state.wanted
            self._state.shown, self._state.after_show = shown, after_show
            if wanted is not None and wanted.serial == shown.serial:
                self._state.down = ""


@dataclass(slots=True)
class _Life:
    """One process of the window and how far the conversation with it has come."""

    window: WindowProcess
    opened: bool = False
    told: int = 0
    closing: bool = False
    failed: Failed | None = None
    patience_until: float = 0.0

    def __post_init__(self) -> None:
        self.patience_until = time.monotonic() + OPEN_S


def replace_problem(beat: Beat, problem: str) -> Beat:
    """The same beat with another problem."""
    return Beat(problem=problem, late=beat.late)


def replace_gamma(setup: Setup, gamma_before: bytes) -> Setup:
    """The same set-up with the gamma table that is to be restored at the end."""
    return Setup(options=setup.options, display=setup.display, gamma_before=gamma_before)
