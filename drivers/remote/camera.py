"""A camera in a process of its own, behind the protocol of every camera.

Vendor libraries hold Python's lock while they wait, install signal handlers, leak, crash and hang; in a process of
its own each of these interrupts one camera and nothing else of the daemon (docs/decisions/0009). Any end of the
process is a DeviceLost, and ``open`` starts another one.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import socket
import subprocess
import threading
import time
import weakref
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import msgspec

from drivers import child_process
from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.protocols import CameraHealth, CameraInfo, Frame, Side
from drivers.remote import messages
from drivers.remote.messages import Command, Configure, Done, Failed, FrameReady, FrameTaken, Opened, SlotReleased
from drivers.remote.outbox import WINDOW
from drivers.remote.ring import RingReader, added

_ERRORS: dict[str, type[DriverError]] = {"lost": DeviceLost, "refused": SettingRefused, "driver": DriverError}
_TICK_S = 0.25
_END_S = 1.0
_SPARE = WINDOW + 2


@dataclass(frozen=True, slots=True)
class Limits:
    """Time limits of the camera's process, seconds, and the size of its ring.

    Args:
        slots: frames in shared memory. silence_s: longest time without a heartbeat.
        open_s, command_s: for opening, and for starting and stopping. close_s: before it is killed.
    """

    slots: int = 16
    silence_s: float = 5.0
    open_s: float = 60.0
    command_s: float = 20.0
    close_s: float = 5.0


@dataclass(slots=True, eq=False)
class _Process:
    """One run of the camera's process."""

    process: subprocess.Popen[bytes]
    socket: socket.socket
    output: child_process.OutputReader
    poll: select.poll
    ring: RingReader | None = None
    lent: set[int] = field(default_factory=set)
    backlog: deque[int] = field(default_factory=deque)


class RemoteCamera:
    """Any camera, driven by a process of its own.

    Args:
        target: ``module:function`` that creates the camera in the process from (side, options, base_dir).
        options: plain values, as read from a file.
        limits: beyond which the process is killed.
    """

    def __init__(
        self, side: Side, target: str, options: Mapping[str, Any], base_dir: Path, *, limits: Limits | None = None
    ) -> None:
        self.side = side
        self._limits = limits or Limits()
        self._configure = Configure(target, side, dict(options), str(base_dir), self._limits.slots, os.getpid())
        self._log = logging.getLogger(f"fringed.camera.{side}")
        self._child: _Process | None = None
        self._number = 0
        self._lock = threading.Lock()
        self._past: dict[str, int] = {}
        self._counters = {"shared": 0, "copied": 0, "processes": 0}

    @property
    def pid(self) -> int | None:
        """Id of the camera's process, None while there is none."""
        return self._child.process.pid if self._child is not None else None

    def open(self) -> CameraInfo:
        """Start the process and open the camera there.

        Raises:
            DeviceLost: it does not exist, or its process died or hung. SettingRefused: from the camera.
        """
        self.close()
        child = self._start()
        try:
            self._send(child, self._configure)
            answer = self._command(child, "open", self._limits.open_s)
        except BaseException:
            self._end()
            raise
        if not isinstance(answer, Opened):
            self._lost("it answered the command to open without opening")
        return CameraInfo(answer.model, answer.serial, answer.size, answer.encoding, answer.exposure_us, answer.notes)

    def start(self) -> None:
        """Begin to accept triggers."""
        self._command(self._running(), "start", self._limits.command_s)

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next frame; its image lies in shared memory, which is released with its last reference."""
        child = self._running()
        end = time.monotonic() + timeout_s
        while True:
            left = end - time.monotonic()
            message = self._receive(child, min(max(left, 0.0), _TICK_S))
            if isinstance(message, FrameReady):
                return self._frame(child, message)
            if isinstance(message, Failed):
                self._end()
                raise _ERRORS[message.kind](message.message)
            if message is None:
                self._check(child)
                if left <= 0:
                    return None

    def stop(self) -> None:
        """Stop accepting triggers; frames in transit are dropped."""
        self._command(self._running(), "stop", self._limits.command_s)

    def close(self) -> None:
        """Close the camera and end the process."""
        if self._child is not None:
            with suppress(DriverError, OSError):
                self._command(self._child, "close", self._limits.close_s)
            self._end()

    def health(self) -> CameraHealth:
        """Return the last health of the process, at most about a second old, with the counters of this side."""
        with self._lock:
            ring = self._child.ring if self._child is not None else None
            now = ring.health() if ring is not None else CameraHealth()
            return CameraHealth(now.temperature_c, added(added(self._past, now.counters), self._counters))

    def _start(self) -> _Process:
        ours, theirs = messages.pair()
        with theirs:
            try:
                process = child_process.start(
                    "drivers.remote.child", [str(theirs.fileno())], pass_fds=[theirs.fileno()]
                )
            except BaseException:
                ours.close()
                raise
        poll = select.poll()
        poll.register(ours, select.POLLIN)
        output = child_process.OutputReader(process, self._log, f"output-{self.side}")
        child = _Process(process, ours, output, poll)
        with self._lock:
            self._child = child
            self._counters["processes"] += 1
        return child

    def _running(self) -> _Process:
        if self._child is None:
            raise DeviceLost(f"the {self.side} camera is not open")
        return self._child

    def _command(self, child: _Process, action: Any, timeout_s: float) -> messages.ToParent:
        """Send a command and wait for its answer; frames that come meanwhile are dropped."""
        self._number += 1
        self._send(child, Command(self._number, action))
        end = time.monotonic() + timeout_s
        while (left := end - time.monotonic()) > 0:
            message = self._receive(child, min(left, _TICK_S))
            if isinstance(message, FrameReady):
                self._send(child, FrameTaken(message.slot, kept=False))
            elif isinstance(message, Done | Opened) and message.number == self._number:
                return message
            elif isinstance(message, Failed) and message.number in (-1, self._number):
                self._end()
                raise _ERRORS[message.kind](message.message)
        return self._lost(f"it did not {action} within {timeout_s:g} s")

    def _receive(self, child: _Process, timeout_s: float) -> messages.ToParent | None:
        while child.backlog:
            self._send(child, SlotReleased(child.backlog.popleft()))
        if not child.poll.poll(timeout_s * 1000):
            return None
        try:
            data, fds, _, _ = socket.recv_fds(child.socket, messages.MAX_MESSAGE, 1)
        except ConnectionError:
            data, fds = b"", []
        try:
            if not data:
                self._lost("it ended")
            message = messages.decode_for_parent(data)
            if isinstance(message, Opened):
                if not fds:
                    self._lost("it opened without sending its memory")
                ring = RingReader(fds[0], message.slots, message.slot_bytes)
                with self._lock:
                    child.ring = ring
        except msgspec.DecodeError as error:
            self._lost(f"it sent an invalid message: {error}")
        finally:
            for fd in fds:
                os.close(fd)
        return message

    def _frame(self, child: _Process, ready: FrameReady) -> Frame:
        if child.ring is None:
            self._lost("it sent a frame before it was open")
        image = child.ring.image(ready.slot, ready.shape, wide=ready.wide)
        kept = len(child.lent) < child.ring.slots - _SPARE
        if kept:
            child.lent.add(ready.slot)
            weakref.finalize(image, _release, child.socket, child.lent, child.backlog, ready.slot).atexit = False
        else:
            image = image.copy()
            image.flags.writeable = False
        self._counters["shared" if kept else "copied"] += 1
        self._send(child, FrameTaken(ready.slot, kept))
        return Frame(
            side=self.side,
            trigger=ready.trigger,
            t_exposure_ns=ready.t_exposure_ns,
            t_host_ns=ready.t_host_ns,
            encoding=ready.encoding,
            image=image,
            exposure_us=ready.exposure_us,
            t_device_ns=ready.t_device_ns,
            frame_id=ready.frame_id,
        )

    def _check(self, child: _Process) -> None:
        silent_s = child.ring.age_ns(time.monotonic_ns()) / 1e9 if child.ring is not None else 0.0
        if silent_s > self._limits.silence_s:
            self._lost(f"it has sent no heartbeat for {silent_s:.1f} s")

    def _send(self, child: _Process, message: messages.ToChild) -> None:
        try:
            child.socket.send(messages.encode(message))
        except OSError as error:
            self._lost(f"it is gone ({error.strerror})")

    def _lost(self, reason: str) -> NoReturn:
        status, last = self._end()
        ending = f"; exit status {status}" if status not in (None, 0, -9) else ""
        output = f"; its output: {last}" if last else ""
        raise DeviceLost(f"the process of the {self.side} camera was ended: {reason}{ending}{output}")

    def _end(self) -> tuple[int | None, str]:
        """Kill the process if it still runs and release everything; return its exit status and last output."""
        child = self._child
        if child is None:
            return None, ""
        with self._lock:
            self._child = None
            if child.ring is not None:
                self._past = added(self._past, child.ring.health().counters)
        child.socket.close()
        status = child_process.end(child.process, _END_S)
        child.output.join(_END_S)
        return status, child.output.text()


def _release(connection: socket.socket, lent: set[int], backlog: deque[int], slot: int) -> None:
    """Release a slot, from any thread, possibly during garbage collection: takes no lock and never waits."""
    lent.discard(slot)
    try:
        connection.send(messages.encode(SlotReleased(slot)), socket.MSG_DONTWAIT)
    except OSError as error:
        if error.errno == errno.EAGAIN:
            backlog.append(slot)
