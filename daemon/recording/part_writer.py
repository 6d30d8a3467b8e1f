"""One file of a take while it is written: MCAP, a chunk for each pair, its real name only once it is whole."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from daemon.atomic import sync_directory
from daemon.recording.parts import PARTIAL
from daemon.recording.raw_image import encode
from drivers.protocols import SIDES, Frame

VERSION = "1"
_COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
# Chunks are ended by hand, after each pair.
_NEVER = 1 << 40


class PartWriter:
    """A new file; FileExistsError if either of its names is taken.

    Args:
        path: final name; until :meth:`finish` the file has ``.partial`` behind it.
        attachments: name -> bytes; metadata: the record ``fringed`` without its version.
        created_ns: CLOCK_REALTIME.
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
        if path.exists():
            raise FileExistsError(errno.EEXIST, "exists already", str(path))
        self._file = self.partial.open("xb")
        try:
            self._writer = Writer(self._file, chunk_size=_NEVER, compression=_COMPRESSIONS[compression])
            self._writer.start(library="fringed")
            for name, data in attachments.items():
                self._writer.add_attachment(created_ns, created_ns, name, _media_type(name), data)
            self._writer.add_metadata("fringed", {"version": VERSION, **metadata})
            schema = self._writer.register_schema("foxglove.RawImage", "protobuf", _schema())
            self._channels = {
                side: self._writer.register_channel(f"/{side}/image", "protobuf", schema) for side in SIDES
            }
            self.sync()
            sync_directory(path.parent)
        except BaseException:
            self.abandon()
            raise

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._file.tell()

    @property
    def handle(self) -> int:
        """The file's descriptor; ValueError once it is closed."""
        return self._file.fileno()

    def write(self, *frames: Frame) -> None:
        """Write frames that belong together as one chunk; ImageError, and nothing written, if one cannot be."""
        messages = [encode(f.t_exposure_ns, f.side, f.encoding, f.image) for f in frames]
        for frame, data in zip(frames, messages, strict=True):
            self._writer.add_message(
                self._channels[frame.side], frame.t_host_ns, data, frame.t_exposure_ns, frame.trigger
            )
        self._writer.flush()

    def sync(self) -> None:
        """Bring everything written so far to the disk."""
        self._writer.flush()
        os.fdatasync(self._file.fileno())

    def finish(self) -> None:
        """Write index and footer, and give the file its name."""
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        if self.path.exists():
            raise FileExistsError(
                errno.EEXIST, "appeared while the take was being written; it stays in", str(self.partial)
            )
        self.partial.rename(self.path)
        sync_directory(self.path.parent)

    def abandon(self) -> None:
        """Let go of the file as it is; what is on the disk can be read up to its last whole chunk."""
        try:
            self._file.close()
        except OSError:
            # Its buffer could not be written; the handle is closed all the same.
            self._file.raw.close()


def _media_type(name: str) -> str:
    kinds = {".yaml": "application/yaml", ".json": "application/json"}
    return kinds.get(Path(name).suffix, "application/octet-stream")


def _schema() -> bytes:
    """The FileDescriptorSet of foxglove.RawImage, its imports first."""
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
