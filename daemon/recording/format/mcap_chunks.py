"""The messages of a chunk, decompressed and verified by its checksum."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import replace
from typing import BinaryIO

from daemon.recording.format.mcap_index import FileIndex, read_record, split_records
from daemon.recording.format.mcap_records import (
    MAX_CHUNK,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Cursor,
    DamageError,
    Location,
    Message,
    Opcode,
)

_CHUNK_HEAD = RECORD_HEAD + 40 + 32
"""Bytes that hold the head of a chunk: times, size, checksum, name of the compression, length."""


def load(file: BinaryIO, location: Location) -> bytes | memoryview:
    """Return the records of a chunk (or the one record of a message outside chunks) as bytes.

    Raises:
        DamageError: the content of the chunk has changed since it was written.
    """
    content = read_record(file, location, MAX_CHUNK + 4096)
    if location.opcode == Opcode.MESSAGE:
        return bytes([Opcode.MESSAGE]) + (location.length - RECORD_HEAD).to_bytes(8, "little") + content
    cursor = Cursor(content)
    cursor.take(16)
    size, crc, compression = cursor.u64(), cursor.u32(), cursor.text()
    records = decompress(cursor.take(cursor.u64()), compression, size)
    if len(records) != size:
        raise DamageError(f"its content has {len(records)} bytes instead of {size}")
    if crc and zlib.crc32(records) != crc:
        raise DamageError("its checksum does not match")
    return records


def messages(records: bytes | memoryview, index: FileIndex) -> Iterator[tuple[Message, int]]:
    """Yield every message of a chunk and its offset in it; add the chunk's schemas and channels to the index."""
    for opcode, content, at in split_records(records):
        if opcode == Opcode.MESSAGE:
            yield Message.parse(content), at
        else:
            index.add_definition(opcode, content)


def heads(file: BinaryIO, location: Location, index: FileIndex) -> Iterator[tuple[Message, int]]:
    """Yield every message of a chunk without its data, and its offset, as :func:`messages` does.

    Of a chunk that is not compressed only the heads are read, so nothing is verified by its checksum.
    """
    if location.opcode == Opcode.MESSAGE:
        file.seek(location.offset + RECORD_HEAD)
        yield Message.parse(memoryview(file.read(MESSAGE_HEAD))), 0
        return
    file.seek(location.offset)
    first = Cursor(file.read(_CHUNK_HEAD))
    first.take(RECORD_HEAD + 16)
    size, _, compression = first.u64(), first.u32(), first.text()
    if compression:
        for message, at in messages(load(file, location), index):
            yield replace(message, data=memoryview(b"")), at
        return
    start = location.offset + first.at + 8
    if first.u64() != size or start + size > location.end:
        raise DamageError("its head is damaged")
    yield from _heads(file, start, size, index)


def _heads(file: BinaryIO, start: int, size: int, index: FileIndex) -> Iterator[tuple[Message, int]]:
    """Go from record to record of ``size`` bytes that begin at byte ``start`` of the file."""
    at = 0
    while at < size:
        file.seek(start + at)
        piece = Cursor(file.read(RECORD_HEAD + MESSAGE_HEAD))
        opcode, length = piece.take(1)[0], piece.u64()
        if at + RECORD_HEAD + length > size:
            raise DamageError(f"{length} bytes expected, {size - at - RECORD_HEAD} left")
        if opcode == Opcode.MESSAGE:
            yield Message.parse(piece.take(min(MESSAGE_HEAD, length))), at
        else:
            file.seek(start + at + RECORD_HEAD)
            index.add_definition(opcode, file.read(length))
        at += RECORD_HEAD + length


def decompress(data: memoryview, compression: str, size: int) -> bytes | memoryview:
    """Return the decompressed bytes, never more than ``size``."""
    if size > MAX_CHUNK:
        raise DamageError(f"a chunk of {size} bytes, limit {MAX_CHUNK}")
    if compression == "":
        return data
    if compression == "zstd":
        return _unzstd(data, size)
    if compression == "lz4":
        return _unlz4(data, size)
    raise DamageError(f"its compression {compression!r:.20} is not zstd or lz4")


def _unzstd(data: memoryview, size: int) -> bytes:
    import zstandard

    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            return reader.read(size + 1) if size else b""
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamageError(f"zstd: {error}") from error


def _unlz4(data: memoryview, size: int) -> bytes:
    import lz4.frame

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (RuntimeError, EOFError, MemoryError) as error:
        raise DamageError(f"lz4: {error}") from error
