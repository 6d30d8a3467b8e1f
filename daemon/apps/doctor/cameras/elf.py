"""The processor and the dependencies of a shared library, read from its ELF header without loading it.

Source: Tool Interface Standard, Executable and Linking Format, and its 64-bit extension.
"""

from __future__ import annotations

import mmap
import platform
import struct
from dataclasses import dataclass
from pathlib import Path

MACHINES = {3: "i386", 40: "arm", 62: "x86_64", 183: "aarch64"}
_PT_LOAD, _PT_DYNAMIC = 1, 2
_DT_NULL, _DT_NEEDED, _DT_STRTAB = 0, 1, 5
_MAX_HEADERS, _MAX_ENTRIES, _MAX_NAME = 256, 4096, 256


class ElfError(ValueError):
    """Not a shared library, or a damaged one."""


@dataclass(frozen=True, slots=True)
class Library:
    """A shared library: its processor, and the names of the libraries that it needs."""

    machine: str
    needed: tuple[str, ...]

    @property
    def fits(self) -> bool:
        """Whether it is built for this machine's processor."""
        return self.machine == {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())


def read(path: Path) -> Library:
    """Read a library's header.

    Raises:
        ElfError: not a library, or truncated. OSError: it is unreadable.
    """
    with path.open("rb") as file:
        if path.stat().st_size < 64:
            raise ElfError(f"{path} is no shared library: {path.stat().st_size} bytes")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                return _parse(data, path)
            except (struct.error, IndexError, ValueError) as error:
                raise ElfError(str(error) if isinstance(error, ElfError) else f"{path} is truncated") from error


def _parse(data: mmap.mmap, path: Path) -> Library:
    if data[:4] != b"\x7fELF":
        raise ElfError(f"{path} is no shared library")
    if data[5] != 1:
        raise ElfError(f"{path} is built for a big-endian processor")
    number = struct.unpack_from("<H", data, 18)[0]
    machine = MACHINES.get(number, f"processor {number}")
    if data[4] != 2:
        return Library(f"{machine}, 32 bit" if number == 62 else machine, ())
    loads, dynamic = [], None
    start, size, count = *struct.unpack_from("<Q", data, 32), *struct.unpack_from("<HH", data, 54)
    for i in range(min(count, _MAX_HEADERS)):
        kind, _, offset, address, _, length = struct.unpack_from("<IIQQQQ", data, start + i * size)
        if kind == _PT_LOAD:
            loads.append((address, offset, length))
        elif kind == _PT_DYNAMIC:
            dynamic = offset, length
    return Library(machine, _needed(data, loads, dynamic) if dynamic else ())


def _needed(data: mmap.mmap, loads: list[tuple[int, int, int]], dynamic: tuple[int, int]) -> tuple[str, ...]:
    names, table = [], 0
    for i in range(min(dynamic[1] // 16, _MAX_ENTRIES)):
        tag, value = struct.unpack_from("<qQ", data, dynamic[0] + 16 * i)
        if tag == _DT_NULL:
            break
        if tag == _DT_NEEDED:
            names.append(value)
        elif tag == _DT_STRTAB:
            table = next(
                (value - address + offset for address, offset, size in loads if 0 <= value - address < size), 0
            )
    libraries = []
    for name in names:
        end = data.find(b"\0", table + name, table + name + _MAX_NAME)
        libraries.append(data[table + name : end].decode(errors="replace") if end > 0 else "")
    return tuple(libraries)
