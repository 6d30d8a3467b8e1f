"""The messages of a chunk, decompressed and verified by its checksum."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import BinaryIO

from daemon.recording.format.mcap_index import FileIndex, read_record, split_records
from daemon.recording.format.mcap_records import MAX_CHUNK, RECORD_HEAD, Cursor, DamageError, Location, Message, Opcode


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
