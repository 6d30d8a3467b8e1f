"""Where everything lies in an MCAP file: by its index if that is sound, else by walking up to the damage."""

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
    Opcode,
    Place,
    Schema,
    index_place,
)

_SMALL = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA)
_INDEXES = (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)


@dataclass(slots=True)
class Survey:
    """What lies where.

    Args:
        size: of the file, bytes.
        data: chunks (and messages outside chunks) in the order of the file; small: attachments and metadata.
        messages: count by channel; first_ns, last_ns: log times of the first and the last, 0 without any.
        whole: the file has its end; ``readable_to`` is the byte up to which it can be read, ``problem`` says why no
            further.
    """

    size: int
    data: list[Place] = field(default_factory=list)
    small: list[Place] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: Counter[int] = field(default_factory=Counter)
    first_ns: int = 0
    last_ns: int = 0
    whole: bool = False
    readable_to: int = 0
    problem: str = ""

    def learn(self, opcode: int, content: bytes | memoryview, *, again: bool = True) -> None:
        """Keep a schema or a channel; other records are passed over.

        Args:
            again: replace what is known already; False for the repetition in a summary that is not proven.
        """
        if opcode == Opcode.SCHEMA:
            schema = Schema.parse(content)
            if again or schema.id not in self.schemas:
                self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.parse(content)
            if again or channel.id not in self.channels:
                self.channels[channel.id] = channel

    def times(self, first_ns: int, last_ns: int) -> None:
        """There are messages from one time to another."""
        self.first_ns = min(self.first_ns or first_ns, first_ns)
        self.last_ns = max(self.last_ns, last_ns)

    def statistics(self, content: memoryview) -> int:
        """Learn from the record of this kind; returns the number of messages."""
        cursor = Cursor(content)
        count = cursor.u64()
        cursor.take(18)
        if count:
            self.times(cursor.u64(), cursor.u64())
        else:
            cursor.take(16)
        rows = Cursor(cursor.take(cursor.u32()))
        while rows.left:
            self.messages[rows.u16()] += rows.u64()
        return count


def survey(file: BinaryIO) -> Survey:
    """Find everything in an MCAP file.

    Raises:
        DamageError: when it is no MCAP file at all.
    """
    size = file.seek(0, 2)
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise DamageError("byte 0: this is not an MCAP file")
    try:
        return _by_index(file, size)
    except DamageError as error:
        found = _by_walking(file, size)
        found.problem = found.problem or f"its index cannot be used ({error}); everything else was found"
        return found


def read_record(file: BinaryIO, place: Place, limit: int) -> bytes:
    """The content of a record whose head must say what ``place`` says."""
    if not RECORD_HEAD <= place.length <= limit:
        raise DamageError(f"a record of {place.length} bytes, limit {limit}")
    file.seek(place.offset)
    head = file.read(RECORD_HEAD)
    if len(head) < RECORD_HEAD or head[0] != place.opcode or int.from_bytes(head[1:], "little") + 9 != place.length:
        raise DamageError("its head is damaged")
    content = file.read(place.length - RECORD_HEAD)
    if len(content) != place.length - RECORD_HEAD:
        raise DamageError("cut off")
    return content


def split_records(data: bytes | memoryview) -> Iterator[tuple[int, memoryview, int]]:
    """Kind, content and offset of every record in bytes that hold nothing else."""
    cursor = Cursor(data)
    while cursor.left:
        at = cursor.at
        opcode = cursor.take(1)[0]
        yield opcode, cursor.take(cursor.u64()), at


def _by_index(file: BinaryIO, size: int) -> Survey:
    start, summary = _summary(file, size)
    found = Survey(size, whole=True, readable_to=size)
    messages = 0
    for opcode, content, _ in split_records(summary):
        if opcode in _INDEXES:
            place = index_place(opcode, content)
            if place.offset < len(MAGIC) or place.length < RECORD_HEAD or place.end > start:
                raise DamageError("it points outside the file")
            (found.data if place.opcode == Opcode.CHUNK else found.small).append(place)
        elif opcode == Opcode.STATISTICS:
            messages = found.statistics(content)
        else:
            found.learn(opcode, content)
    if messages and not found.data:
        raise DamageError("it lists no chunks")
    found.data.sort(key=lambda place: place.offset)
    return found


def _summary(file: BinaryIO, size: int) -> tuple[int, bytes]:
    """Offset and bytes of the summary, proven by its checksum."""
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
        raise DamageError("its checksum does not fit")
    return start, summary


def _by_walking(file: BinaryIO, size: int) -> Survey:
    """Go from record to record until the end or something impossible."""
    found = Survey(size, readable_to=len(MAGIC))
    in_data = True
    while not found.whole:
        place = _next(file, found)
        if place is None:
            break
        try:
            if place.opcode in _SMALL:
                content = read_record(file, place, MAX_SMALL_RECORD)
                found.learn(place.opcode, content, again=in_data)
            elif place.opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX) and in_data:
                _count(file, place, found)
        except DamageError as error:
            found.problem = found.problem or f"damaged at byte {place.offset}: {error}"
        if in_data and place.opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            found.data.append(place)
        elif place.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
            found.small.append(place)
        in_data = in_data and place.opcode != Opcode.DATA_END
        found.readable_to = place.end
        if place.opcode == Opcode.FOOTER:
            file.seek(place.end)
            found.whole = file.read(len(MAGIC)) == MAGIC
    return found


def _count(file: BinaryIO, place: Place, found: Survey) -> None:
    """Learn counts and times from the heads of chunks and their indexes; the messages themselves are not read."""
    file.seek(place.offset + RECORD_HEAD)
    head = Cursor(file.read(min(22, place.length - RECORD_HEAD)))
    if place.opcode == Opcode.MESSAGE_INDEX:
        found.messages[head.u16()] += head.u32() // 16
    elif place.opcode == Opcode.CHUNK:
        found.times(head.u64(), head.u64())
    else:
        found.messages[head.u16()] += 1
        head.take(4)
        t_ns = head.u64()
        found.times(t_ns, t_ns)


def _next(file: BinaryIO, found: Survey) -> Place | None:
    """The record that follows; None, with the reason noted, where there is none."""
    offset = found.readable_to
    file.seek(offset)
    head = file.read(RECORD_HEAD)
    if len(head) < RECORD_HEAD:
        found.problem = f"the file was cut off at byte {found.size}"
        return None
    place = Place(head[0], offset, RECORD_HEAD + int.from_bytes(head[1:], "little"))
    if head[0] == 0 or place.length > max(MAX_CHUNK, MAX_SMALL_RECORD):
        found.problem = f"damaged at byte {offset}: there is no record; what follows cannot be read"
        return None
    if place.end > found.size:
        found.problem = f"the file was cut off at byte {found.size}, or is damaged at byte {offset}"
        return None
    return place
