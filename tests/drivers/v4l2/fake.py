"""A simulated kernel with one camera: it follows the rules of the real one and breaks them on request."""

from __future__ import annotations

import errno
import os
import time
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.v4l2 import structs as v
from drivers.v4l2.controls import Kind
from drivers.v4l2.kernel import Argument

PATH = "/dev/fake"


@dataclass
class FakeControl:
    id: int
    name: str
    kind: Kind = Kind.INTEGER
    minimum: int = 0
    maximum: int = 255
    value: int = 0
    flags: int = 0
    menu: dict[int, str] = field(default_factory=dict)


def exposure_controls(mode: int = v.EXPOSURE_AUTO_MANUAL, units: int = 100) -> list[FakeControl]:
    menu = {0: "Auto Mode", 1: "Manual Mode", 3: "Aperture Priority Mode"}
    return [
        FakeControl(v.CID_EXPOSURE_AUTO, "Auto Exposure", Kind.MENU, 0, 3, mode, menu=menu),
        FakeControl(v.CID_EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", Kind.INTEGER, 1, 5000, units),
    ]


class Memory(bytearray):
    """The memory of a buffer."""

    closed = False

    def close(self) -> None:
        self.closed = True


class FakeKernel:
    """One camera at PATH.

    Args:
        formats: fourcc to sizes; grant: how many buffers it gives at most; row_padding: bytes after each row.
    """

    def __init__(
        self,
        formats: dict[str, list[tuple[int, int]]] | None = None,
        *,
        controls: list[FakeControl] | None = None,
        grant: int = 32,
        row_padding: int = 0,
        capabilities: int = v.CAP_VIDEO_CAPTURE | v.CAP_STREAMING,
        rates_hz: tuple[float, ...] = (),
    ) -> None:
        self.formats = formats or {"GREY": [(32, 16)]}
        self.controls = {control.id: control for control in controls or []}
        self.grant, self.row_padding, self.capabilities, self.rates_hz = grant, row_padding, capabilities, rates_hz
        self.present = True
        self.errors: dict[int, deque[int]] = defaultdict(deque)
        """Error numbers that the next requests of a kind answer with."""
        self.open_errors: deque[int] = deque()
        self.wakes_for_nothing = 0
        self.broken = False
        self.flags = v.BUF_FLAG_TIMESTAMP_MONOTONIC
        self.sequence = 0
        self.fds: set[int] = set()
        self.memories: list[Memory] = []
        self.queued: deque[int] = deque()
        self.done: deque[v.Buffer] = deque()
        self.streaming = False
        self.set_order: list[str] = []
        name = next(iter(self.formats))
        self.pix = self._layout(name, self.formats[name][0])

    # ---- what the tests do to it

    def expose(
        self, data: bytes, *, flags: int = 0, timestamp_ns: int | None = None, used: int | None = None, skip: int = 0
    ) -> bool:
        """The sensor gives an image; False when there was no buffer for it. ``skip`` lets numbers be missing."""
        self.sequence = (self.sequence + skip) % 2**32
        number, self.sequence = self.sequence, (self.sequence + 1) % 2**32
        if not self.streaming or not self.queued:
            return False
        index = self.queued.popleft()
        self.memories[index][: len(data)] = data
        stamp = time.monotonic_ns() if timestamp_ns is None else timestamp_ns
        self.done.append(
            v.Buffer(
                index=index,
                bytesused=len(data) if used is None else used,
                flags=self.flags | flags,
                timestamp_s=stamp // 10**9,
                timestamp_us=stamp % 10**9 // 1000,
                sequence=number,
            )
        )
        return True

    # ---- the protocol

    def open(self, path: str) -> int:
        if self.open_errors:
            raise _error(self.open_errors.popleft())
        if path != PATH or not self.present:
            raise _error(errno.ENOENT)
        fd = 1000 + len(self.fds)
        self.fds.add(fd)
        return fd

    def close(self, fd: int) -> None:
        self.fds.remove(fd)
        self._forget()

    def map(self, fd: int, length: int, offset: int) -> Memory:
        assert fd in self.fds and length == len(self.memories[offset // 4096])
        return self.memories[offset // 4096]

    def wait(self, fd: int, timeout_s: float) -> bool:
        assert fd in self.fds and timeout_s < 60
        if self.wakes_for_nothing:
            self.wakes_for_nothing -= 1
            return True
        return bool(self.done) or not self.present or self.broken

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        assert fd in self.fds
        if not self.present:
            raise _error(errno.ENODEV)
        if self.errors[request]:
            raise _error(self.errors[request].popleft())
        answers: dict[int, Callable[[Any], None]] = {
            v.QUERYCAP: self._querycap,
            v.ENUM_FMT: self._enum_fmt,
            v.ENUM_FRAMESIZES: self._enum_sizes,
            v.G_FMT: self._g_fmt,
            v.S_FMT: self._s_fmt,
            v.G_PARM: self._g_parm,
            v.S_PARM: self._s_parm,
            v.QUERY_EXT_CTRL: self._query_control,
            v.QUERYMENU: self._query_menu,
            v.G_CTRL: self._g_control,
            v.S_CTRL: self._s_control,
            v.REQBUFS: self._reqbufs,
            v.QUERYBUF: self._querybuf,
            v.QBUF: self._qbuf,
            v.DQBUF: self._dqbuf,
            v.STREAMON: self._streamon,
            v.STREAMOFF: self._streamoff,
        }
        answers[request](argument)

    def _querycap(self, a: v.Capability) -> None:
        a.driver, a.card, a.bus_info = b"fake", b"Fake camera", b"bus-7"
        a.capabilities = v.CAP_DEVICE_CAPS | 0xFFFF
        a.device_caps = self.capabilities

    def _enum_fmt(self, a: v.FormatDescription) -> None:
        names = list(self.formats)
        _require(a.index < len(names))
        a.pixelformat, a.description = v.fourcc(names[a.index]), b"a format"

    def _enum_sizes(self, a: v.FrameSize) -> None:
        sizes = self.formats[v.fourcc_name(a.pixel_format)]
        _require(a.index < len(sizes))
        a.type = v.FRAME_SIZE_DISCRETE
        a.discrete.width, a.discrete.height = sizes[a.index]

    def _layout(self, name: str, size: tuple[int, int]) -> v.PixelFormat:
        pixel_bytes = {"GREY": 1, "MJPG": 0, "RGB3": 3}.get(name, 2)
        row = size[0] * pixel_bytes + self.row_padding
        return v.PixelFormat(
            width=size[0],
            height=size[1],
            pixelformat=v.fourcc(name),
            bytesperline=row,
            sizeimage=max(4096, row * size[1]),
        )

    def _g_fmt(self, a: v.Format) -> None:
        a.fmt.pix = self.pix

    def _s_fmt(self, a: v.Format) -> None:
        name = v.fourcc_name(a.fmt.pix.pixelformat)
        if name not in self.formats:
            name = next(iter(self.formats))
        size = (a.fmt.pix.width, a.fmt.pix.height)
        self.pix = self._layout(name, size if size in self.formats[name] else self.formats[name][0])
        a.fmt.pix = self.pix

    def _g_parm(self, a: v.StreamParameters) -> None:
        a.parm.capture.capability = v.CAP_TIMEPERFRAME if self.rates_hz else 0

    def _s_parm(self, a: v.StreamParameters) -> None:
        interval = a.parm.capture.timeperframe
        wanted = interval.denominator / interval.numerator
        taken = min(self.rates_hz, key=lambda rate: abs(rate - wanted))
        interval.numerator, interval.denominator = 10, round(10 * taken)

    def _query_control(self, a: v.QueryControl) -> None:
        if a.id & v.CTRL_FLAG_NEXT_CTRL:
            later = sorted(number for number in self.controls if number > a.id & ~v.CTRL_FLAG_NEXT_CTRL)
            _require(bool(later))
            a.id = later[0]
        _require(a.id in self.controls)
        control = self.controls[a.id]
        a.type, a.name, a.minimum, a.maximum = control.kind, control.name.encode(), control.minimum, control.maximum
        a.step, a.flags = 1, control.flags

    def _query_menu(self, a: v.QueryMenu) -> None:
        menu = self.controls[a.id].menu
        _require(a.index in menu)
        if self.controls[a.id].kind is Kind.INTEGER_MENU:
            a.value = int(menu[a.index])
        else:
            a.name = menu[a.index].encode()

    def _g_control(self, a: v.Control) -> None:
        a.value = self.controls[a.id].value

    def _s_control(self, a: v.Control) -> None:
        control = self.controls[a.id]
        if control.flags & v.CTRL_FLAG_READ_ONLY:
            raise _error(errno.EACCES)
        self.set_order.append(control.name)
        control.value = a.value = min(max(a.value, control.minimum), control.maximum)

    def _reqbufs(self, a: v.RequestBuffers) -> None:
        self._forget()
        a.count = min(a.count, self.grant)
        self.memories = [Memory(self.pix.sizeimage) for _ in range(a.count)]

    def _querybuf(self, a: v.Buffer) -> None:
        _require(a.index < len(self.memories))
        a.length, a.offset = len(self.memories[a.index]), a.index * 4096

    def _qbuf(self, a: v.Buffer) -> None:
        _require(a.index < len(self.memories) and a.index not in self.queued)
        self.queued.append(a.index)

    def _dqbuf(self, a: v.Buffer) -> None:
        if self.broken:
            raise _error(errno.EIO)
        if not self.done:
            raise _error(errno.EAGAIN)
        filled = self.done.popleft()
        for name in ("index", "bytesused", "flags", "timestamp_s", "timestamp_us", "sequence"):
            setattr(a, name, getattr(filled, name))

    def _streamon(self, _: Any) -> None:
        self.streaming, self.sequence, self.broken = True, 0, False

    def _streamoff(self, _: Any) -> None:
        self.streaming = False
        self.queued.clear()
        self.done.clear()

    def _forget(self) -> None:
        self._streamoff(None)
        self.memories = []


def _error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


def _require(fulfilled: bool) -> None:
    if not fulfilled:
        raise _error(errno.EINVAL)
