"""The contents of an MCAP file, collected while it is written, and the index and footer made from them."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from mcap import records as mcap_records
from mcap.data_stream import RecordBuilder

from daemon.recording.format.mcap_records import MAGIC, Opcode


@dataclass(slots=True)
class Contents:
    """The records of the summary section."""

    schema: Any = None
    channels: list[Any] = field(default_factory=list)
    chunks: list[Any] = field(default_factory=list)
    attachments: list[Any] = field(default_factory=list)
    metadatas: list[Any] = field(default_factory=list)
    messages: Counter[int] = field(default_factory=Counter)
    first_ns: int | None = None
    last_ns: int = 0

    def attachment(self, offset: int, record: bytes, t_ns: int, name: str, media_type: str, size: int) -> None:
        """Add the attachment at this offset."""
        self.attachments.append(
            mcap_records.AttachmentIndex(
                offset=offset,
                length=len(record),
                log_time=t_ns,
                create_time=t_ns,
                data_size=size,
                name=name,
                media_type=media_type,
            )
        )

    def metadata(self, offset: int, record: bytes, name: str) -> None:
        """Add the metadata record at this offset."""
        self.metadatas.append(mcap_records.MetadataIndex(offset=offset, length=len(record), name=name))

    def chunk(
        self,
        offset: int,
        length: int,
        entries: list[tuple[int, int, int]],
        indexes: list[bytes],
        compression: str,
        stored: int,
        size: int,
    ) -> None:
        """Add the chunk at this offset, directly followed by its message indexes.

        Args:
            entries: (channel, log_ns, offset in the chunk) of every message; indexes: one a channel, by its number.
            stored, size: bytes with and without compression.
        """
        times = [log_ns for _, log_ns, _ in entries]
        channels = sorted({number for number, _, _ in entries})
        starts, at = {}, offset + length
        for number, index in zip(channels, indexes, strict=True):
            starts[number] = at
            at += len(index)
        self.chunks.append(
            mcap_records.ChunkIndex(
                message_start_time=min(times),
                message_end_time=max(times),
                chunk_start_offset=offset,
                chunk_length=length,
                message_index_offsets=starts,
                message_index_length=at - offset - length,
                compression=compression,
                compressed_size=stored,
                uncompressed_size=size,
            )
        )
        self.messages.update(number for number, _, _ in entries)
        self.first_ns = min(times) if self.first_ns is None else min(self.first_ns, *times)
        self.last_ns = max(self.last_ns, *times)

    def ending(self, offset: int) -> bytes:
        """Return the bytes from the end of the data, at this offset, to the end of the file."""
        data_end, summary, offsets = RecordBuilder(), RecordBuilder(), []
        mcap_records.DataEnd(0).write(data_end)
        head = data_end.end()
        start = offset + len(head)
        for opcode, records in self._groups():
            before = summary.count
            for record in records:
                record.write(summary)
            if records:
                offsets.append(mcap_records.SummaryOffset(opcode, start + before, summary.count - before))
        offsets_start = start + summary.count
        for record in offsets:
            record.write(summary)
        body = summary.end()
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(footer, zlib.crc32(body))
        return bytes(head + body + footer + struct.pack("<I", crc) + MAGIC)

    def _groups(self) -> list[tuple[Opcode, list[Any]]]:
        statistics = mcap_records.Statistics(
            message_count=self.messages.total(),
            schema_count=1,
            channel_count=len(self.channels),
            attachment_count=len(self.attachments),
            metadata_count=len(self.metadatas),
            chunk_count=len(self.chunks),
            message_start_time=self.first_ns or 0,
            message_end_time=self.last_ns,
            channel_message_counts=dict(self.messages),
        )
        return [
            (Opcode.SCHEMA, [self.schema]),
            (Opcode.CHANNEL, self.channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.ATTACHMENT_INDEX, self.attachments),
            (Opcode.METADATA_INDEX, self.metadatas),
        ]
