"""MCAP records parsed from bytes, every length checked before it is used."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = 9
MESSAGE_HEAD = 22
FOOTER_BYTES = RECORD_HEAD + 20 + len(MAGIC)
MAX_SMALL_RECORD = 64 << 20
MAX_CHUNK = 1 << 30


class Opcode(IntEnum):
    """Kinds of records."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


class DamageError(ValueError):
    """Bytes that are not a valid record of the expected kind."""


class Cursor:
    """Reads numbers and strings from bytes, one after the other."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self.at = 0

    @property
    def left(self) -> int:
        """Bytes not yet read."""
        return len(self._data) - self.at

    def take(self, length: int) -> memoryview:
        """Return the next bytes, not copied."""
        if length > self.left:
            raise DamageError(f"{length} bytes expected, {self.left} left")
        piece = self._data[self.at : self.at + length]
        self.at += length
        return piece

    def u16(self) -> int:
        """Return a number of two bytes."""
        return int.from_bytes(self.take(2), "little")

    def u32(self) -> int:
        """Return a number of four bytes."""
        return int.from_bytes(self.take(4), "little")

    def u64(self) -> int:
        """Return a number of eight bytes."""
        return int.from_bytes(self.take(8), "little")

    def text(self) -> str:
        """Return a string, which follows its length."""
        try:
            return bytes(self.take(self.u32())).decode("utf-8")
        except UnicodeDecodeError as error:
            raise DamageError("a string is not UTF-8") from error

    def texts(self) -> dict[str, str]:
        """Return a map of strings, which follows its length in bytes."""
        inner = Cursor(self.take(self.u32()))
        out: dict[str, str] = {}
        while inner.left:
            key = inner.text()
            out[key] = inner.text()
        return out


@dataclass(frozen=True, slots=True)
class Schema:
    """The format of a channel's messages."""

    id: int
    name: str
    encoding: str

    @classmethod
    def parse(cls, data: bytes | memoryview) -> Schema:
        """Parse the content of the record."""
        cursor = Cursor(data)
        return cls(cursor.u16(), cursor.text(), cursor.text())


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of the file."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str

    @classmethod
    def parse(cls, data: bytes | memoryview) -> Channel:
        """Parse the content of the record."""
        cursor = Cursor(data)
        return cls(cursor.u16(), cursor.u16(), cursor.text(), cursor.text())


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """One message; ``data`` is a view into its chunk."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: memoryview

    @classmethod
    def parse(cls, data: memoryview) -> Message:
        """Parse the content of the record."""
        if len(data) < MESSAGE_HEAD:
            raise DamageError(f"a message of {len(data)} bytes")
        channel_id, sequence, log_ns, publish_ns = struct.unpack_from("<HIQQ", data)
        return cls(channel_id, sequence, log_ns, publish_ns, data[MESSAGE_HEAD:])


@dataclass(frozen=True, slots=True, eq=False)
class Attachment:
    """A file inside the file."""

    name: str
    media_type: str
    data: bytes

    @classmethod
    def parse(cls, data: bytes | memoryview) -> Attachment:
        """Parse the content of the record; its checksum must match."""
        cursor = Cursor(data)
        cursor.take(16)
        name, media_type = cursor.text(), cursor.text()
        content = bytes(cursor.take(cursor.u64()))
        checked = cursor.at
        crc = cursor.u32()
        if crc and crc != zlib.crc32(memoryview(data)[:checked]):
            raise DamageError(f"attachment {name!r}: its checksum does not match")
        return cls(name, media_type, content)


@dataclass(frozen=True, slots=True)
class Metadata:
    """A named table of strings."""

    name: str
    values: dict[str, str]

    @classmethod
    def parse(cls, data: bytes | memoryview) -> Metadata:
        """Parse the content of the record."""
        cursor = Cursor(data)
        return cls(cursor.text(), cursor.texts())


@dataclass(frozen=True, slots=True)
class Location:
    """Location of a record in the file, its nine bytes of head included."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """The byte after it."""
        return self.offset + self.length


def indexed_location(opcode: int, data: bytes | memoryview) -> Location:
    """Return the location that an index record points at."""
    cursor = Cursor(data)
    if opcode == Opcode.CHUNK_INDEX:
        cursor.take(16)
        return Location(Opcode.CHUNK, cursor.u64(), cursor.u64())
    kind = Opcode.ATTACHMENT if opcode == Opcode.ATTACHMENT_INDEX else Opcode.METADATA
    return Location(kind, cursor.u64(), cursor.u64())
