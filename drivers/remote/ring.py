"""Frames in shared memory: a ring of slots that the camera's process fills and the daemon only reads.

The memory is anonymous (memfd), so nothing can be left behind; it is sealed against changes of its size, so neither
side can make the other fault. It begins with a status block: heartbeat and health of the camera's process, which the
daemon reads at any time. A checksum detects a block that is being written.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
import time
import zlib
from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError
from drivers.protocols import CameraHealth

_STATUS_BYTES = 8192
_HEARTBEAT_BYTES = 8
_HEAD = struct.Struct("<II")
_ALIGN = 4096
MAX_SLOTS = 256
MAX_RING_BYTES = 4 << 30


class _Health(msgspec.Struct):
    temperature_c: float | None
    counters: dict[str, int]


_encoder = msgspec.json.Encoder()
_decoder: msgspec.json.Decoder[_Health] = msgspec.json.Decoder(_Health)


def _ring_bytes(slots: int, slot_bytes: int) -> int:
    size = _STATUS_BYTES + slots * slot_bytes
    if not (2 < slots <= MAX_SLOTS and slot_bytes % _ALIGN == 0 and 0 < size <= MAX_RING_BYTES):
        raise DriverError(f"{slots} slots of {slot_bytes} bytes do not make a ring of at most {MAX_RING_BYTES} bytes")
    return size


def _heartbeat_of(memory: mmap.mmap) -> NDArray[np.int64]:
    """Return the heartbeat as one aligned number, written and read atomically: ``struct`` clears its bytes first."""
    return np.ndarray((1,), np.dtype(np.int64), buffer=memory)


class RingWriter:
    """The camera's side: owns the memory and provides slots to fill.

    Args:
        slots: 3 .. 256; frame_bytes: of the largest frame.
    """

    def __init__(self, slots: int, frame_bytes: int) -> None:
        self.slots, self.slot_bytes = slots, -(-frame_bytes // _ALIGN) * _ALIGN
        size = _ring_bytes(slots, self.slot_bytes)
        self.fd = os.memfd_create("fringed-frames", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(self.fd, size)
        fcntl.fcntl(self.fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        self._map = mmap.mmap(self.fd, size)
        self._heartbeat = _heartbeat_of(self._map)

    def heartbeat(self) -> None:
        """Write the heartbeat of this process."""
        self._heartbeat[0] = time.monotonic_ns()

    def write_health(self, health: CameraHealth) -> None:
        """Write the health into the status block."""
        text = _encoder.encode(_Health(health.temperature_c, dict(health.counters)))
        limit = _STATUS_BYTES - _HEARTBEAT_BYTES - _HEAD.size
        if len(text) > limit:
            raise ValueError(f"the health of a camera takes {len(text)} bytes; at most {limit}")
        start = _HEARTBEAT_BYTES + _HEAD.size
        self._map[start : start + len(text)] = text
        _HEAD.pack_into(self._map, _HEARTBEAT_BYTES, len(text), zlib.crc32(text))

    def slot(
        self, index: int, shape: tuple[int, ...], dtype: np.dtype[np.uint8] | np.dtype[np.uint16]
    ) -> NDArray[np.uint8]:
        """Return a slot as an array to fill."""
        if int(np.prod(shape)) * dtype.itemsize > self.slot_bytes:
            raise ValueError(f"an image of {shape} {dtype} does not fit into a slot of {self.slot_bytes} bytes")
        return np.ndarray(shape, dtype, buffer=self._map, offset=_STATUS_BYTES + index * self.slot_bytes)


class RingReader:
    """The daemon's side: the images, the heartbeat and the health.

    The memory is freed with the last image in it.
    """

    def __init__(self, fd: int, slots: int, slot_bytes: int) -> None:
        size = _ring_bytes(slots, slot_bytes)
        if os.fstat(fd).st_size != size:
            raise DriverError(
                f"the camera's process sent {os.fstat(fd).st_size} bytes of shared memory instead of {size}"
            )
        self.slots, self._slot_bytes = slots, slot_bytes
        self._map = mmap.mmap(fd, size, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ)
        self._heartbeat = _heartbeat_of(self._map)
        self._health = CameraHealth()

    def age_ns(self, now_ns: int) -> int:
        """Return the time since the last heartbeat of the camera's process; ``now_ns`` is CLOCK_MONOTONIC."""
        return now_ns - int(self._heartbeat[0])

    def health(self) -> CameraHealth:
        """Return the health of the status block, or the last valid one."""
        length, checksum = _HEAD.unpack_from(self._map, _HEARTBEAT_BYTES)
        start = _HEARTBEAT_BYTES + _HEAD.size
        text = self._map[start : start + min(length, _STATUS_BYTES - start)]
        if length and zlib.crc32(text) == checksum:
            health = _decoder.decode(text)
            self._health = CameraHealth(health.temperature_c, health.counters)
        return self._health

    def image(self, index: int, shape: tuple[int, ...], *, wide: bool) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Return the image in a slot: a read-only view that the caller releases."""
        dtype = np.dtype(np.uint16 if wide else np.uint8)
        if not 0 <= index < self.slots or int(np.prod(shape)) * dtype.itemsize > self._slot_bytes or min(shape) < 0:
            raise DriverError(f"the camera's process announced slot {index}, image {shape}: it does not exist")
        return np.ndarray(shape, dtype, buffer=self._map, offset=_STATUS_BYTES + index * self._slot_bytes)


def added(first: Mapping[str, int], second: Mapping[str, int]) -> dict[str, int]:
    """Return the sums of two tables of counters."""
    return {key: first.get(key, 0) + second.get(key, 0) for key in [*first, *(k for k in second if k not in first)]}
