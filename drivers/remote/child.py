"""The camera's process: one thread that executes commands, reads the camera and reports its health.

Started by :class:`drivers.remote.camera.RemoteCamera`; ends on its command or with it: by the end of the connection,
or, should a vendor's library hang, by the kernel's parent-death signal. Signals meant for the daemon (Ctrl-C, a service
manager's SIGTERM) reach this process too and are ignored; the daemon then closes the camera in order.

A camera that fills buffers writes its images into the ring, see :class:`drivers.protocols.FillsBuffers`.
"""

from __future__ import annotations

import importlib
import logging
import os
import select
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any

from drivers.child_process import die_with_parent
from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.protocols import Camera, CameraHealth, CameraInfo, FillsBuffers
from drivers.remote.messages import (
    MAX_MESSAGE,
    Command,
    Configure,
    Done,
    Failed,
    FrameReady,
    FrameTaken,
    Opened,
    ToParent,
    decode_for_child,
    encode,
)
from drivers.remote.outbox import Outbox
from drivers.remote.ring import RingWriter

_IDLE_S = 0.1
_READ_S = 0.02
_HEALTH_S = 1.0
_MAX_NOTES, _MAX_NOTE = 60, 500


class _End(Exception):
    """The daemon has closed the connection, or has commanded the end."""


class Child:
    """Serves one camera.

    Args:
        connection: to the daemon, message by message.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._poll = select.poll()
        self._poll.register(connection, select.POLLIN)
        self._slots = 0
        self._camera: Camera | None = None
        self._ring: RingWriter | None = None
        self._outbox: Outbox | None = None
        self._acquiring = False
        self._next_health = 0.0

    def serve(self) -> None:
        """Serve until the daemon ends the process or the connection."""
        try:
            while True:
                self._listen(0.0 if self._acquiring else _IDLE_S)
                if self._acquiring:
                    self._read()
                self._write_status()
        except (_End, ConnectionError):
            pass
        finally:
            if self._camera is not None:
                self._camera.close()

    def _listen(self, timeout_s: float) -> None:
        while self._poll.poll(timeout_s * 1000):
            timeout_s = 0.0
            data = self._socket.recv(MAX_MESSAGE)
            if not data:
                raise _End
            message = decode_for_child(data)
            if isinstance(message, Command):
                self._execute(message)
            elif isinstance(message, Configure):
                self._configure(message)
            elif self._outbox is not None and isinstance(message, FrameTaken):
                self._outbox.taken(message.slot, kept=message.kept)
            elif self._outbox is not None:
                self._outbox.release(message.slot)

    def _configure(self, message: Configure) -> None:
        die_with_parent(message.parent)
        module, _, name = message.target.partition(":")
        opener: Any = getattr(importlib.import_module(module), name)
        self._slots = message.slots
        self._camera = opener(message.side, message.options, Path(message.base_dir))

    def _execute(self, command: Command) -> None:
        camera = self._camera
        if camera is None:
            raise _End
        try:
            if command.action == "open":
                self._opened(command.number, camera.open())
                return
            if command.action == "close":
                self._acquiring = False
                camera.close()
                self._send(Done(command.number))
                raise _End
            self._switch(camera, on=command.action == "start")
            self._send(Done(command.number))
        except (_End, ConnectionError):
            raise
        except Exception as error:
            self._fail(command.number, error)

    def _switch(self, camera: Camera, *, on: bool) -> None:
        self._acquiring = False
        if on:
            camera.start()
        else:
            camera.stop()
        if self._outbox is not None:
            self._outbox.clear()
        self._acquiring = on

    def _opened(self, number: int, info: CameraInfo) -> None:
        width, height = info.size
        bytes_per_pixel = {"rgb8": 3, "mono16": 2}.get(info.encoding, 1)
        self._ring = RingWriter(self._slots, width * height * bytes_per_pixel)
        self._ring.heartbeat()
        self._outbox = Outbox(self._ring, self._announce)
        camera = self._camera
        if camera is not None and isinstance(camera, FillsBuffers):
            camera.allocate = self._outbox.allocate
        message = Opened(
            number=number,
            model=info.model,
            serial=info.serial,
            size=info.size,
            encoding=info.encoding,
            exposure_us=info.exposure_us,
            notes=tuple(note[:_MAX_NOTE] for note in info.notes[:_MAX_NOTES]),
            slot_bytes=self._ring.slot_bytes,
            slots=self._ring.slots,
        )
        socket.send_fds(self._socket, [encode(message)], [self._ring.fd])
        os.close(self._ring.fd)

    def _announce(self, ready: FrameReady) -> None:
        self._send(ready)

    def _read(self) -> None:
        camera, outbox = self._camera, self._outbox
        if camera is None or outbox is None:
            return
        try:
            frame = camera.read(_READ_S)
        except Exception as error:
            self._acquiring = False
            self._fail(-1, error)
            camera.close()
            return
        if frame is not None:
            outbox.put(frame)

    def _write_status(self) -> None:
        ring, camera, outbox = self._ring, self._camera, self._outbox
        if ring is None or camera is None or outbox is None:
            return
        ring.heartbeat()
        now = time.monotonic()
        if now >= self._next_health:
            self._next_health = now + _HEALTH_S
            health = camera.health()
            ring.write_health(CameraHealth(health.temperature_c, {**health.counters, "ring_full": outbox.ring_full}))

    def _fail(self, number: int, error: Exception) -> None:
        known = isinstance(error, DriverError)
        if not known:
            logging.getLogger(__name__).exception("unexpected error")
        kind = "lost" if isinstance(error, DeviceLost) else "refused" if isinstance(error, SettingRefused) else "driver"
        text = str(error) if known else f"{type(error).__name__}: {error}"
        self._send(Failed(number, kind, text[: MAX_MESSAGE // 8]))  # type: ignore[arg-type]

    def _send(self, message: ToParent) -> None:
        self._socket.send(encode(message))


def main() -> None:
    """``python -m drivers.remote.child FD``: serve the connection with file descriptor FD."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(levelname).1s %(name)s: %(message)s")
    with socket.socket(fileno=int(sys.argv[1])) as connection:
        Child(connection).serve()


if __name__ == "__main__":
    main()
