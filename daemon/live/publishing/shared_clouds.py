"""Clouds in shared memory: one copy for all subscribers on this machine, instead of one through a socket for each.

A message that refers to the memory has a few hundred bytes (:mod:`fringed.shared_memory` has the format). The slots are
written in turn, so that a reader has the time of several clouds to copy one.
"""

from __future__ import annotations

import errno
import hashlib
import mmap
import os
import secrets
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from fringed.shared_memory import NUMBER_BYTES, Reference

MOST_SLOTS, LEAST_SLOTS = 8, 3
_PAGE = mmap.PAGESIZE
_MEMORY = Path("/dev/shm")  # noqa: S108 - files get a random name and are created exclusively


@dataclass(frozen=True, slots=True)
class _File:
    """Memory with slots of one size."""

    path: Path
    map: mmap.mmap
    slots: int
    slot_bytes: int

    def write_number(self, slot: int, number: int) -> None:
        """Write the number of a slot's content; 0 while it changes."""
        self.map[slot : slot + NUMBER_BYTES] = number.to_bytes(NUMBER_BYTES, "little")


class SharedClouds:
    """Slots for clouds, in a file in memory beside the stream's local socket; for one thread.

    The file is created with the first cloud, and a larger one where clouds become larger. Who may connect to the socket
    may read it.

    Args:
        endpoints: of the stream, bound. limit_bytes: of the file; 0 = none.
    """

    def __init__(self, endpoints: Iterable[str], *, limit_bytes: int) -> None:
        sockets = [Path(one.removeprefix("ipc://")) for one in endpoints if one.startswith("ipc://")]
        #: Whether clouds can be stored.
        self.available = bool(sockets) and limit_bytes > 0
        self._limit, self._number = limit_bytes, 0
        self._file: _File | None = None
        if sockets:
            self._socket = sockets[0].absolute()
            self._directory = _in_memory(self._socket.parent)
            self._prefix = f"fringed-{hashlib.sha256(str(self._socket).encode()).hexdigest()[:16]}-"
            # Of a daemon that was killed: this one has bound the same socket.
            for stale in self._directory.glob(f"{self._prefix}*"):
                with suppress(OSError):
                    stale.unlink()

    def store(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, bytes]:
        """Copy arrays into the next slot; returns a reference to each.

        Raises:
            OSError: there is no room for at least three clouds; the limit, or free memory, is too small.
        """
        offsets, size = {}, _PAGE
        for name, array in arrays.items():
            offsets[name] = size
            size += -(-array.nbytes // _PAGE) * _PAGE
        file = self._file if self._file is not None and size <= self._file.slot_bytes else self._allocate(size)
        number, slot = self._number + 1, self._number % file.slots * file.slot_bytes
        file.write_number(slot, 0)
        for name, array in arrays.items():
            place = np.frombuffer(file.map, array.dtype.newbyteorder("<"), array.size, slot + offsets[name])
            np.copyto(place.reshape(array.shape), array)
        file.write_number(slot, number)
        self._number = number
        return {
            name: msgspec.json.encode(Reference(file=str(file.path), slot=slot, number=number, at=slot + offset))
            for name, offset in offsets.items()
        }

    def close(self) -> None:
        """Remove the file; readers that have it keep their view. May be called twice."""
        if self._file is not None:
            with suppress(OSError):
                self._file.path.unlink()
            self._file.map.close()
        self._file = None

    def _allocate(self, slot_bytes: int) -> _File:
        """Replace the file by one with slots of this size, as many as the limit and the free memory allow."""
        self.close()
        slots = min(MOST_SLOTS, self._limit // slot_bytes)
        path = self._directory / f"{self._prefix}{secrets.token_hex(4)}"
        while slots >= LEAST_SLOTS:
            try:
                memory = _created(path, slots * slot_bytes, self._socket)
            except OSError as error:
                if error.errno not in (errno.ENOSPC, errno.ENOMEM):
                    raise
                slots -= 1
            else:
                self._file = _File(path, memory, slots, slot_bytes)
                return self._file
        raise OSError(
            errno.ENOSPC,
            f"shared memory in {self._directory}: no room for {LEAST_SLOTS} clouds of {slot_bytes >> 20} MiB within "
            f"{self._limit >> 20} MiB; raise stream.shared_memory_mb or free memory there",
        )


def _created(path: Path, size: int, socket: Path) -> mmap.mmap:
    """A new file with its memory allocated: a write where there is none would end the process."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        os.posix_fallocate(descriptor, 0, size)
        with suppress(OSError):  # only members of the group may give it to the group
            os.fchown(descriptor, -1, socket.stat().st_gid)
            os.fchmod(descriptor, 0o640)
        return mmap.mmap(descriptor, size, mmap.MAP_SHARED)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)


def _in_memory(directory: Path) -> Path:
    """The directory of the socket, or, if its file system is not in memory, that of the machine's shared memory."""
    device = directory.stat().st_dev
    wanted = f"{os.major(device)}:{os.minor(device)}"
    for line in Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        fields = line.split()
        if fields[2] == wanted and fields[fields.index("-") + 1] in ("tmpfs", "ramfs"):
            return directory
    return _MEMORY
