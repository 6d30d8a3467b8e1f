"""One file of a take while it is written: MCAP, one chunk a pair, its final name only once it is whole.

The chunks are assembled here and passed to the kernel in pieces: the images are never copied, which takes a fraction
of the time that a general MCAP writer needs. The small records are written by the ``mcap`` package.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap import records as mcap_records
from mcap.data_stream import RecordBuilder

from daemon.common.files import rename_without_replacing, sync_directory
from daemon.recording.format.file_lock import lock
from daemon.recording.format.mcap_records import MAGIC, RECORD_HEAD, Opcode
from daemon.recording.format.mcap_summary import Contents
from daemon.recording.format.part_names import PARTIAL
from daemon.recording.format.raw_image import pieces
from drivers.protocols import SIDES, Frame, Side

VERSION = "1"
CHANNELS: dict[Side, int] = {side: number for number, side in enumerate(SIDES, 1)}
_SCHEMA_ID = 1
_Piece = bytes | memoryview


class PartWriter:
    """A new file; FileExistsError if either of its names is taken; locked while it is written.

    Args:
        path: final name; until :meth:`finish` the file has ``.partial`` behind it.
        attachments: name -> bytes; metadata: the record ``fringed`` without its version.
        created_ns: CLOCK_REALTIME; compression: of the chunks, ``none``, ``lz4`` or ``zstd``.
    """

    def __init__(
        self,
        path: Path,
        *,
        attachments: Mapping[str, bytes],
        metadata: Mapping[str, str],
        created_ns: int,
        compression: str = "none",
    ) -> None:
        self.path, self.partial = path, path.with_name(path.name + PARTIAL)
        self._compression, self._compress = _COMPRESSORS[compression]
        if path.exists():
            raise FileExistsError(errno.EEXIST, "exists already", str(path))
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self._file: int | None = os.open(self.partial, flags, 0o666)
        self._end = 0
        self.kept = True  # False once a sync failed: which pages are on the disk is then unknown
        self._contents = Contents()
        try:
            lock(self.handle)
            self._begin(attachments, {"version": VERSION, **metadata}, created_ns)
            self.sync()
            sync_directory(path.parent)
        except BaseException:
            self._close()
            with suppress(OSError):  # it holds no frame yet
                self.partial.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._end

    @property
    def handle(self) -> int:
        """The file's descriptor; ValueError once it is closed."""
        if self._file is None:
            raise ValueError(f"{self.partial} is closed")
        return self._file

    def _begin(self, attachments: Mapping[str, bytes], metadata: Mapping[str, str], created_ns: int) -> None:
        """Write the records that precede the first image."""
        self._append([MAGIC, _bytes(mcap_records.Header(profile="", library="fringed"))])
        for name, data in attachments.items():
            record = _bytes(mcap_records.Attachment(created_ns, created_ns, name, _media_type(name), data))
            self._contents.attachment(self._end, record, created_ns, name, _media_type(name), len(data))
            self._append([record])
        record = _bytes(mcap_records.Metadata(name="fringed", metadata=dict(metadata)))
        self._contents.metadata(self._end, record, "fringed")
        self._append([record])
        self._contents.schema = mcap_records.Schema(
            id=_SCHEMA_ID, name="foxglove.RawImage", encoding="protobuf", data=_schema()
        )
        self._contents.channels = [
            mcap_records.Channel(
                id=number, topic=f"/{side}/image", message_encoding="protobuf", metadata={}, schema_id=_SCHEMA_ID
            )
            for side, number in CHANNELS.items()
        ]
        # Outside the chunks, so that a damaged chunk holds no record that later ones need.
        self._append([_bytes(record) for record in (self._contents.schema, *self._contents.channels)])

    def write(self, *frames: Frame) -> None:
        """Write frames that belong together as one chunk; ImageError, and nothing written, if one is invalid."""
        records: list[_Piece] = []
        entries: list[tuple[int, int, int]] = []
        size = 0
        for frame in frames:
            head, pixels = pieces(frame.t_exposure_ns, frame.side, frame.encoding, frame.image)
            number, length = CHANNELS[frame.side], 22 + len(head) + len(pixels)
            entries.append((number, frame.t_host_ns, size))
            fields = (number, frame.trigger, frame.t_host_ns, frame.t_exposure_ns)
            records += [struct.pack("<BQHIQQ", Opcode.MESSAGE, length, *fields) + head, pixels]
            size += RECORD_HEAD + length
        self._chunk(records, size, entries)

    def _chunk(self, records: list[_Piece], size: int, entries: list[tuple[int, int, int]]) -> None:
        crc = 0
        for piece in records:
            crc = zlib.crc32(piece, crc)
        stored: list[_Piece] = records if self._compress is None else [self._compress(b"".join(records))]
        stored_size = sum(map(len, stored))
        name = self._compression.encode()
        times = [log_ns for _, log_ns, _ in entries]
        length = 40 + len(name) + stored_size
        head = struct.pack("<BQQQQII", Opcode.CHUNK, length, min(times), max(times), size, crc, len(name)) + name
        head += struct.pack("<Q", stored_size)
        indexes = [
            _bytes(mcap_records.MessageIndex(number, [(log_ns, at) for n, log_ns, at in entries if n == number]))
            for number in sorted({number for number, _, _ in entries})
        ]
        start = self._end
        self._append([head, *stored, *indexes])
        self._contents.chunk(start, RECORD_HEAD + length, entries, indexes, self._compression, stored_size, size)

    def _append(self, data: Sequence[_Piece]) -> None:
        """Write pieces in one call; truncate what a full disk has taken of them."""
        left = [memoryview(piece) for piece in data if len(piece)]
        whole = sum(map(len, left))
        try:
            while left:
                written = os.writev(self.handle, left)
                while left and written >= len(left[0]):
                    written -= len(left.pop(0))
                if left:
                    left[0] = left[0][written:]
        except OSError:
            with suppress(OSError):  # the first error is the one to report
                os.ftruncate(self.handle, self._end)
                os.lseek(self.handle, self._end, os.SEEK_SET)
            raise
        self._end += whole

    def sync(self) -> None:
        """Synchronise everything written so far with the disk."""
        os.fdatasync(self.handle)

    def _sync_all(self) -> None:
        try:
            os.fsync(self.handle)
        except OSError:
            self.kept = False
            raise

    def finish(self) -> None:
        """Write index and footer, and give the file its name."""
        if not self.kept:
            raise OSError(errno.EIO, "not all of it is on the disk", str(self.partial))
        self._append([self._contents.ending(self._end)])
        self._sync_all()
        self._close()
        try:
            rename_without_replacing(self.partial, self.path)
        except FileExistsError:
            raise FileExistsError(
                errno.EEXIST, "appeared while the take was being written; it stays in", str(self.partial)
            ) from None
        sync_directory(self.path.parent)

    def abandon(self) -> None:
        """Close the file unfinished; what is on the disk can be read up to its last whole chunk."""
        self._close()

    def _close(self) -> None:
        descriptor, self._file = self._file, None
        if descriptor is not None:
            with suppress(OSError):  # it was synced before, or its failure was reported
                os.close(descriptor)


def _bytes(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _lz4(data: bytes) -> bytes:
    import lz4.frame

    return bytes(lz4.frame.compress(data))


def _zstd(data: bytes) -> bytes:
    import zstandard

    return zstandard.compress(data)


_COMPRESSORS: dict[str, tuple[str, Callable[[bytes], bytes] | None]] = {
    "none": ("", None),
    "lz4": ("lz4", _lz4),
    "zstd": ("zstd", _zstd),
}


def _media_type(name: str) -> str:
    kinds = {".yaml": "application/yaml", ".json": "application/json"}
    return kinds.get(Path(name).suffix, "application/octet-stream")


def _schema() -> bytes:
    """Return the FileDescriptorSet of foxglove.RawImage, its imports first."""
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    files: list[Any] = []

    def add(file: Any) -> None:
        for dependency in file.dependencies:
            add(dependency)
        if file not in files:
            files.append(file)

    add(RawImage.DESCRIPTOR.file)
    out = FileDescriptorSet()
    for file in files:
        file.CopyToProto(out.file.add())
    return bytes(out.SerializeToString())
