"""Clouds in shared memory: what a message refers to, and how a subscriber on the daemon's machine reads it.

The memory is a file with slots. A slot begins with the number of its content (8 bytes, little-endian), which is 0 while
the daemon writes. A reader copies the bytes and then compares the number again: another one means that the daemon has
replaced the content meanwhile.
"""

from __future__ import annotations

import mmap
import os
import stat
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from fringed.errors import OverwrittenError, SharedMemoryError, WireError

MAX_REFERENCE_BYTES = 8192
NUMBER_BYTES = 8
_Offset = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]


class Reference(Struct, frozen=True, kw_only=True):
    """Body of a part with the codec ``shared``, as JSON."""

    file: Annotated[str, Meta(min_length=1, max_length=4096, description="path on the daemon's machine")]
    slot: Annotated[_Offset, Meta(description="offset of the 8 bytes that have the number of the slot's content")]
    number: Annotated[int, Meta(ge=1, le=(1 << 63) - 1, description="which the content has while it is this cloud")]
    at: Annotated[_Offset, Meta(description="offset of the part's first byte")]


_decoder = msgspec.json.Decoder(Reference)


class SharedMemory:
    """Reads parts from the daemon's memory; for one thread."""

    def __init__(self) -> None:
        self._file = ""
        self._map: mmap.mmap | None = None

    def read(self, raw: memoryview, size: int, where: str) -> NDArray[np.uint8]:
        """Return a copy of the bytes that a reference names.

        Args:
            raw: the reference; size: bytes that the part has; where: topic and part, for errors.

        Raises:
            OverwrittenError: a newer cloud has taken the place.
            SharedMemoryError: the file cannot be opened by this process.
            WireError: the reference violates the format, or names bytes that the file does not have.
        """
        if len(raw) > MAX_REFERENCE_BYTES:
            raise WireError(f"{where}: reference of {len(raw)} bytes, limit {MAX_REFERENCE_BYTES}")
        try:
            reference = _decoder.decode(raw)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise WireError(f"{where}: reference to shared memory: {error}") from None
        memory = self._opened(reference.file, where)
        if max(reference.slot + NUMBER_BYTES, reference.at + size) > len(memory):
            raise WireError(
                f"{where}: {size} bytes at {reference.at} and a number at {reference.slot} lie beyond the "
                f"{len(memory)} bytes of {reference.file}"
            )
        out = np.empty(size, np.uint8)
        for copied in (False, True):
            number = int.from_bytes(memory[reference.slot : reference.slot + NUMBER_BYTES], "little")
            if number != reference.number:
                raise OverwrittenError(f"{where}: replaced by a newer cloud before it was read; read faster")
            if not copied:
                np.copyto(out, np.frombuffer(memory, np.uint8, size, reference.at))
        out.setflags(write=False)
        return out

    def close(self) -> None:
        """Release the memory; may be called twice."""
        if self._map is not None:
            self._map.close()
        self._file, self._map = "", None

    def _opened(self, file: str, where: str) -> mmap.mmap:
        if self._map is not None and file == self._file:
            return self._map
        self.close()
        try:
            descriptor = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
            try:
                status = os.fstat(descriptor)
                if not stat.S_ISREG(status.st_mode):
                    raise WireError(f"{where}: {file} is not a regular file")
                self._map = mmap.mmap(descriptor, status.st_size, mmap.MAP_SHARED, mmap.PROT_READ)
            finally:
                os.close(descriptor)
        except FileNotFoundError:
            # A daemon that ends removes its file, and messages of it may still be waiting.
            raise SharedMemoryError(f"{where}: {file} does not exist here; the daemon has ended, or it runs in a "
                                    "container: subscribe with shared=False") from None  # fmt: skip
        except (OSError, ValueError) as error:
            raise SharedMemoryError(f"{where}: cannot map {file}: {error}; subscribe with shared=False") from None
        self._file = file
        return self._map
