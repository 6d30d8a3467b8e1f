"""A camera for the process tests: its images encode their number, and it fails on command."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.protocols import CameraHealth, CameraInfo, Frame, Side

WIDTH, HEIGHT = 48, 32


class FakeCamera:
    """Gives ``frames`` frames as fast as they are read, then acts as in ``then``.

    Args:
        options: ``frames``, ``then`` (nothing, lost, bug, exit, kill, hang, hold_lock), ``at_open`` (nothing, refused,
            driver, hang, exit), ``encoding``, ``pause_s`` before each frame, ``own_memory``: do not fill the
            memory that is offered.
    """

    def __init__(self, side: Side, options: dict[str, Any]) -> None:
        self.side, self.options = side, options
        self.allocate: Any = np.empty
        self.number = 0
        self.opened = self.quiet = 0

    def open(self) -> CameraInfo:
        self._do(self.options.get("at_open", "nothing"))
        self.opened += 1
        notes = ("a note",) * self.options.get("notes", 1)
        return CameraInfo("Fake", "F1", (WIDTH, HEIGHT), self._encoding, 100.0, notes)

    def start(self) -> None:
        os.write(1, b"started\n")

    def read(self, timeout_s: float) -> Frame | None:
        if self.number >= self.options.get("frames", 10):
            self.quiet += 1
            if self.quiet > 15:  # what was given before has been taken by then
                self._do(self.options.get("then", "nothing"))
            time.sleep(timeout_s)
            return None
        time.sleep(self.options.get("pause_s", 0.0))
        shape = (HEIGHT, WIDTH, 3) if self._encoding == "rgb8" else (HEIGHT, WIDTH)
        dtype = np.uint16 if self._encoding == "mono16" else np.uint8
        image = np.empty(shape, dtype) if self.options.get("own_memory") else self.allocate(shape, dtype)
        image[...] = self.number % 251
        image.flags.writeable = False
        frame = Frame(self.side, self.number, self.number * 1000, time.time_ns(), self._encoding, image, 100.0, 5, 7)
        self.number += 1
        return frame

    def stop(self) -> None:
        pass

    def close(self) -> None:
        if self.options.get("slow_close"):
            time.sleep(60)

    def health(self) -> CameraHealth:
        return CameraHealth(21.5, {"given": self.number})

    @property
    def _encoding(self) -> str:
        return str(self.options.get("encoding", "mono8"))

    def _do(self, what: str) -> None:
        if what == "lost":
            raise DeviceLost("the plug was pulled")
        if what == "refused":
            raise SettingRefused("exposure_us 1 became 10")
        if what == "driver":
            raise DriverError("two cameras fit")
        if what == "bug":
            raise KeyError("a bug")
        if what == "exit":
            os.write(2, b"the vendor's library ends here\n")
            os._exit(3)
        if what == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if what == "hang":
            time.sleep(600)
        if what == "hold_lock":
            ctypes.PyDLL(None).sleep(600)  # keeps Python's lock, as vendors' libraries do


def open_camera(side: Side, options: dict[str, Any], base_dir: Path) -> FakeCamera:
    """What the child calls."""
    return FakeCamera(side, {**options, "base_dir": str(base_dir)})
