"""Mapped buffers and their stream: request, queue, dequeue, release."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass

from drivers.errors import DeviceLost, DriverError
from drivers.v4l2 import structs as v
from drivers.v4l2.device import Device
from drivers.v4l2.kernel import Memory

LEAST_BUFFERS = 2
"""With a single one the camera could not write while an image is read."""


@dataclass(frozen=True, slots=True)
class Taken:
    """A filled buffer, valid until the end of the block in which it was taken.

    Args:
        data: the bytes that the device wrote, in place: valid only until the buffer is queued again.
        sequence: the driver's number of the frame; timestamp_ns: of the driver; flags: of the buffer.
        done_ns: when it was dequeued, CLOCK_MONOTONIC.
    """

    data: memoryview
    sequence: int
    timestamp_ns: int
    flags: int
    done_ns: int

    @property
    def error(self) -> bool:
        """Whether the driver reports that the image may be corrupt."""
        return bool(self.flags & v.BUF_FLAG_ERROR)

    @property
    def at_start_of_exposure(self) -> bool:
        """Whether the time stamp is of the start of exposure; else of the end of the frame."""
        return bool(self.flags & v.BUF_FLAG_TSTAMP_SRC_SOE)


class Stream:
    """A device's buffers, mapped from construction to ``close``.

    Args:
        requested: number of buffers; the kernel may grant fewer or more, see ``granted``.

    Raises:
        DeviceLost, DriverError: no buffers, or too few of them.
    """

    def __init__(self, device: Device, requested: int) -> None:
        self._device = device
        self._maps: list[Memory] = []
        self._streaming = False
        request = v.RequestBuffers(count=requested, type=v.VIDEO_CAPTURE, memory=v.MEMORY_MMAP)
        device.request(v.REQBUFS, request, f"requesting {requested} buffers")
        self.granted: int = request.count
        try:
            if self.granted < LEAST_BUFFERS:
                raise DriverError(
                    f"{device.name}: {device.path} grants {self.granted} of {requested} buffers, but"
                    f" {LEAST_BUFFERS} are needed; choose a smaller size or free memory"
                )
            self._maps.extend(self._map(index) for index in range(self.granted))
        except DriverError:
            self.close()
            raise

    def start(self) -> None:
        """Queue all buffers and start."""
        for index in range(self.granted):
            self._queue(index)
        self._device.request(v.STREAMON, ctypes.c_int(v.VIDEO_CAPTURE), "starting the stream")
        self._streaming = True

    def stop(self) -> None:
        """Stop; frames not taken are dropped by the kernel. DeviceLost when the device is gone."""
        if self._streaming:
            self._streaming = False
            self._device.request(v.STREAMOFF, ctypes.c_int(v.VIDEO_CAPTURE), "stopping the stream")

    @contextlib.contextmanager
    def take(self, timeout_s: float) -> Iterator[Taken | None]:
        """Dequeue the next filled buffer for a block; None when none came in time.

        Raises:
            DeviceLost: unplugged, or the driver ended the stream; open the device again.
        """
        buffer = self._dequeue(time.monotonic() + timeout_s)
        if buffer is None:
            yield None
            return
        view = memoryview(self._maps[buffer.index])
        data = view[: min(buffer.bytesused, len(view))]
        try:
            yield Taken(
                data,
                buffer.sequence,
                buffer.timestamp_s * 1_000_000_000 + buffer.timestamp_us * 1_000,
                buffer.flags,
                time.monotonic_ns(),
            )
        finally:
            for part in (data, view):
                with contextlib.suppress(BufferError):  # the reader kept a view; the bytes under it will change
                    part.release()
            self._queue(buffer.index)

    def export(self, index: int) -> int:
        """Return a file descriptor of a buffer (DMA-BUF) for other programs or devices; the caller closes it."""
        request = v.ExportBuffer(type=v.VIDEO_CAPTURE, index=index, flags=os.O_CLOEXEC | os.O_RDONLY)
        self._device.request(v.EXPBUF, request, f"exporting buffer {index}")
        return int(request.fd)

    def close(self) -> None:
        """Stop, unmap and release the buffers; never raises."""
        with contextlib.suppress(DriverError):
            self.stop()
        for memory in self._maps:
            with contextlib.suppress(BufferError, OSError):  # a view still exists: the mapping is freed with it
                memory.close()
        self._maps.clear()
        with contextlib.suppress(DriverError):
            request = v.RequestBuffers(count=0, type=v.VIDEO_CAPTURE, memory=v.MEMORY_MMAP)
            self._device.request(v.REQBUFS, request, "releasing the buffers")

    def _map(self, index: int) -> Memory:
        buffer = self._buffer(index)
        self._device.request(v.QUERYBUF, buffer, f"querying buffer {index}")
        try:
            return self._device.kernel.map(self._device.fd, buffer.length, buffer.offset & 0xFFFF_FFFF)
        except OSError as error:
            self._device.fail(error, f"mapping buffer {index}")

    def _queue(self, index: int) -> None:
        self._device.request(v.QBUF, self._buffer(index), f"queueing buffer {index}")

    def _dequeue(self, end_s: float) -> v.Buffer | None:
        while self._wait(end_s - time.monotonic()):
            buffer = self._buffer(0)
            try:
                self._device.kernel.ioctl(self._device.fd, v.DQBUF, buffer)
            except BlockingIOError:  # spurious wake-up
                if time.monotonic() >= end_s:
                    break
                continue
            except OSError as error:
                self._stream_error(error)
            if buffer.index >= len(self._maps):
                raise DriverError(f"{self._device.name}: the driver gave buffer {buffer.index} of {len(self._maps)}")
            return buffer
        return None

    def _wait(self, timeout_s: float) -> bool:
        try:
            return self._device.kernel.wait(self._device.fd, max(0.0, timeout_s))
        except OSError as error:
            self._device.fail(error, "waiting for a frame")

    def _stream_error(self, error: OSError) -> None:
        if error.errno in (errno.EIO, errno.EPIPE, errno.EINVAL):
            code = errno.errorcode[error.errno]
            raise DeviceLost(
                f"{self._device.name}: {self._device.path} ended its stream ({code}); it must be opened again"
            ) from error
        self._device.fail(error, "taking a frame")

    @staticmethod
    def _buffer(index: int) -> v.Buffer:
        return v.Buffer(index=index, type=v.VIDEO_CAPTURE, memory=v.MEMORY_MMAP)
