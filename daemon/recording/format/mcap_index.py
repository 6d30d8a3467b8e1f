"""The records of an MCAP file, located by its index if that is valid, else by a scan up to the damage."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

from daemon.recording.format.mcap_records import (
    FOOTER_BYTES,
    MAGIC,
    MAX_CHUNK,
    MAX_SMALL_RECORD,
    RECORD_HEAD,
    Channel,
    Cursor,
    DamageError,
    Location,
    Opcode,
    Schema,
    indexed_location,
)

_SMALL = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA)
_INDEXES = (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)


@dataclass(slots=True)
class FileIndex:
    """The locations of an MCAP file's records.

    Args:
        size: of the file, bytes.
        data: chunks (and messages outside chunks) in the order of the file; small: attachments and metadata.
        messages: count by channel; first_ns, last_ns: log times of the first and the last, 0 without any.
        whole: the file has its end; ``readable_to`` is the byte up to which it can be read, ``problem`` the reason
            where that is not its end.
    """

    size: int
    data: list[Location] = field(default_factory=list)
    small: list[Location] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: Counter[int] = field(default_factory=Counter)
    first_ns: int = 0
    last_ns: int = 0
    whole: bool = False
    readable_to: int = 0
    problem: str = ""

    def add_definition(self, opcode: int, content: bytes | memoryview, *, again: bool = True) -> None:
        """Add a schema or a channel; other records are ignored.

        Args:
            again: replace what is there already; False for the repetition in a summary that is not verified.
        """
        if opcode == Opcode.SCHEMA:
            schema = Schema.parse(content)
            if again or schema.id not in self.schemas:
                self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.parse(content)
            if again or channel.id not in self.channels:
                self.channels[channel.id] = channel

    def extend_times(self, first_ns: int, last_ns: int) -> None:
        """Extend the time range by that of some messages."""
        self.first_ns = min(self.first_ns or first_ns, first_ns)
        self.last_ns = max(self.last_ns, last_ns)

    def add_statistics(self, content: memoryview) -> int:
        """Add a statistics record; return its number of messages."""
        cursor = Cursor(content)
        count = cursor.u64()
        cursor.take(18)
        if count:
            self.extend_times(cursor.u64(), cursor.u64())
        else:
            cursor.take(16)
        rows = Cursor(cursor.take(cursor.u32()))
        while rows.left:
            self.messages[rows.u16()] += rows.u64()
        return count


def read_index(file: BinaryIO) -> FileIndex:
    """Locate every record of an MCAP file.

    Raises:
        DamageError: the file is not an MCAP file.
    """
    size = file.seek(0, 2)
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise DamageError("byte 0: this is not an MCAP file")
    try:
        return _by_index(file, size)
    except DamageError as error:
        index = _by_walking(file, size)
        index.problem = index.problem or f"its index cannot be used ({error}); everything else was found"
        return index


def read_record(file: BinaryIO, location: Location, limit: int) -> bytes:
    """Return the content of a record, whose head must match ``location``."""
    if not RECORD_HEAD <= location.length <= limit:
        raise DamageError(f"a record of {location.length} bytes, limit {limit}")
    file.seek(location.offset)
    head = file.read(RECORD_HEAD)
    if (
        len(head) < RECORD_HEAD
        or head[0] != location.opcode
        or int.from_bytes(head[1:], "little") + 9 != location.length
    ):
        raise DamageError("its head is damaged")
    content = file.read(location.length - RECORD_HEAD)
    if len(content) != location.length - RECORD_HEAD:
        raise DamageError("cut off")
    return content


def split_records(data: bytes | memoryview) -> Iterator[tuple[int, memoryview, int]]:
    """Yield opcode, content and offset of every record in bytes that hold records only."""
    cursor = Cursor(data)
    while cursor.left:
        at = cursor.at
        opcode = cursor.take(1)[0]
        yield opcode, cursor.take(cursor.u64()), at


def _by_index(file: BinaryIO, size: int) -> FileIndex:
    start, summary = _summary(file, size)
    index = FileIndex(size, whole=True, readable_to=size)
    messages = 0
    for opcode, content, _ in split_records(summary):
        if opcode in _INDEXES:
            location = indexed_location(opcode, content)
            if location.offset < len(MAGIC) or location.length < RECORD_HEAD or location.end > start:
                raise DamageError("it points outside the file")
            (index.data if location.opcode == Opcode.CHUNK else index.small).append(location)
        elif opcode == Opcode.STATISTICS:
            messages = index.add_statistics(content)
        else:
            index.add_definition(opcode, content)
    if messages and not index.data:
        raise DamageError("it lists no chunks")
    index.data.sort(key=lambda location: location.offset)
    return index


def _summary(file: BinaryIO, size: int) -> tuple[int, bytes]:
    """Return offset and bytes of the summary, verified by its checksum."""
    if size < len(MAGIC) + FOOTER_BYTES:
        raise DamageError("the file ends early")
    file.seek(size - FOOTER_BYTES)
    footer = file.read(FOOTER_BYTES)
    if footer[-8:] != MAGIC or footer[0] != Opcode.FOOTER or footer[1:9] != (20).to_bytes(8, "little"):
        raise DamageError("the file has no end")
    start, _, crc = struct.unpack_from("<QQI", footer, RECORD_HEAD)
    length = size - FOOTER_BYTES - start
    if start < len(MAGIC) or not 0 <= length <= MAX_SMALL_RECORD or crc == 0:
        raise DamageError("there is none")
    file.seek(start)
    summary = file.read(length)
    if zlib.crc32(footer[: RECORD_HEAD + 16], zlib.crc32(summary)) != crc:
        raise DamageError("its checksum does not match")
    return start, summary


def _by_walking(file: BinaryIO, size: int) -> FileIndex:
    """Read record after record, up to the end or an impossible one."""
    index = FileIndex(size, readable_to=len(MAGIC))
    in_data = True
    while not index.whole:
        location = _next(file, index)
        if location is None:
            break
        try:
            if location.opcode in _SMALL:
                content = read_record(file, location, MAX_SMALL_RECORD)
                index.add_definition(location.opcode, content, again=in_data)
            elif location.opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX) and in_data:
                _count(file, location, index)
        except DamageError as error:
            index.problem = index.problem or f"damaged at byte {location.offset}: {error}"
        if in_data and location.opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            index.data.append(location)
        elif location.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
            index.small.append(location)
        in_data = in_data and location.opcode != Opcode.DATA_END
        index.readable_to = location.end
        if location.opcode == Opcode.FOOTER:
            file.seek(location.end)
            index.whole = file.read(len(MAGIC)) == MAGIC
    return index


def _count(file: BinaryIO, location: Location, index: FileIndex) -> None:
    """Add counts and times from the heads of chunks and their indexes; no message is read."""
    file.seek(location.offset + RECORD_HEAD)
    head = Cursor(file.read(min(22, location.length - RECORD_HEAD)))
    if location.opcode == Opcode.MESSAGE_INDEX:
        index.messages[head.u16()] += head.u32() // 16
    elif location.opcode == Opcode.CHUNK:
        index.extend_times(head.u64(), head.u64())
    else:
        index.messages[head.u16()] += 1
        head.take(4)
        t_ns = head.u64()
        index.extend_times(t_ns, t_ns)


def _next(file: BinaryIO, index: FileIndex) -> Location | None:
    """Return the next record's location; None, with ``problem`` set, where there is none."""
    offset = index.readable_to
    file.seek(offset)
    head = file.read(RECORD_HEAD)
    if len(head) < RECORD_HEAD:
        index.problem = f"the file was cut off at byte {index.size}"
        return None
    location = Location(head[0], offset, RECORD_HEAD + int.from_bytes(head[1:], "little"))
    if head[0] == 0 or location.length > max(MAX_CHUNK, MAX_SMALL_RECORD):
        index.problem = f"damaged at byte {offset}: there is no record; what follows cannot be read"
        return None
    if location.end > index.size:
        index.problem = f"the file was cut off at byte {index.size}, or is damaged at byte {offset}"
        return None
    return location
