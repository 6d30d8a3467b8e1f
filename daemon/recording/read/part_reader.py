"""One file of a take: its attachments and its undamaged frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daemon.recording.format import mcap_chunks
from daemon.recording.format.errors import TakeError
from daemon.recording.format.mcap_index import FileIndex, read_index, read_record
from daemon.recording.format.mcap_records import (
    MAX_SMALL_RECORD,
    Attachment,
    DamageError,
    Location,
    Message,
    Metadata,
    Opcode,
)
from daemon.recording.format.raw_image import ImageError, decode
from drivers.protocols import SIDES, Frame, Side

VERSION = "1"
SCHEMA = "foxglove.RawImage"
_TOPICS: dict[str, Side] = {f"/{side}/image": side for side in SIDES}
_MAX_PROBLEMS = 20


@dataclass(frozen=True, slots=True)
class FrameLocation:
    """Location of a frame: its chunk, and the offset of the message inside it."""

    chunk: Location
    offset: int


class PartReader:
    """One MCAP file.

    Args:
        path: of the file.

    Raises:
        TakeError: a file that cannot be read, is not a take, or is of an unsupported version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, str] = {}
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise TakeError(f"{path}: {error.strerror or error}") from error
        try:
            self.index: FileIndex = read_index(self._file)
            self._read_small()
        except DamageError as error:
            self.close()
            raise TakeError(f"{path}: {error}") from error
        except OSError as error:
            self.close()
            raise TakeError(f"{path}: {error.strerror or error}") from error
        except BaseException:
            self.close()
            raise
        if self.index.problem:
            self.add_problem(self.index.problem)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def counts(self) -> Counter[Side]:
        """Return the frames by camera from the file's index or the heads of its chunks; no frame is read."""
        out: Counter[Side] = Counter()
        for channel_id, count in self.index.messages.items():
            channel = self.index.channels.get(channel_id)
            side = _TOPICS.get(channel.topic) if channel is not None else None
            if side is not None:
                out[side] += count
        return out

    def frames(self) -> Iterator[tuple[Frame, FrameLocation]]:
        """Yield every undamaged frame, in the order of the file."""
        for location in self.index.data:
            yield from self.frames_in(location)

    def frames_in(self, location: Location) -> Iterator[tuple[Frame, FrameLocation]]:
        """Yield the undamaged frames of one chunk."""
        records = self._load(location)
        if records is None:
            return
        try:
            for message, offset in mcap_chunks.messages(records, self.index):
                frame = self._frame(message, location)
                if frame is not None:
                    yield frame, FrameLocation(location, offset)
        except DamageError as error:
            self.add_problem(f"damaged at byte {location.offset}: {error}")

    def heads(self) -> Iterator[tuple[Frame, FrameLocation]]:
        """Yield every frame without its image, which is then neither read nor verified, in the order of the file.

        Each frame has the encoding ``""`` and, in place of its image, its location.
        """
        for location in self.index.data:
            try:
                for message, offset in mcap_chunks.heads(self._file, location, self.index):
                    side = self._side(message.channel_id, location)
                    if side is not None:
                        place: Any = FrameLocation(location, offset)
                        yield Frame(side, message.sequence, message.publish_ns, message.log_ns, "", place), place
            except DamageError as error:
                self.add_problem(f"damaged at byte {location.offset}: {error}; its frames are left out")
            except OSError as error:
                raise TakeError(f"{self.path}: byte {location.offset}: {error}") from error

    def frame_at(self, location: FrameLocation) -> Frame | None:
        """Read one frame again; None if that fails."""
        records = self._load(location.chunk)
        for message, offset in mcap_chunks.messages(records, self.index) if records is not None else ():
            if offset == location.offset:
                return self._frame(message, location.chunk)
        return None

    def _load(self, location: Location) -> bytes | memoryview | None:
        try:
            return mcap_chunks.load(self._file, location)
        except DamageError as error:
            self.add_problem(f"damaged at byte {location.offset}: {error}; its frames are left out")
            return None
        except OSError as error:
            raise TakeError(f"{self.path}: byte {location.offset}: {error}") from error

    def _frame(self, message: Message, location: Location) -> Frame | None:
        side = self._side(message.channel_id, location)
        if side is None:
            return None
        try:
            image = decode(message.data)
        except ImageError as error:
            self.add_problem(f"damaged at byte {location.offset}: {side} image {message.sequence}: {error}")
            return None
        return Frame(side, message.sequence, message.publish_ns, message.log_ns, image.encoding, image.image)

    def _side(self, channel_id: int, location: Location) -> Side | None:
        """Return the camera of a channel; None for channels of other topics."""
        channel = self.index.channels.get(channel_id)
        if channel is None:
            self.add_problem(f"damaged at byte {location.offset}: channel {channel_id} is not described")
            return None
        side = _TOPICS.get(channel.topic)
        if side is None:
            return None
        schema = self.index.schemas.get(channel.schema_id)
        if channel.message_encoding != "protobuf" or schema is None or schema.name != SCHEMA:
            held = f"{schema.name if schema else 'unknown'} as {channel.message_encoding}"
            raise TakeError(f"{self.path}: channel {channel.topic} holds {held:.100}, expected {SCHEMA} as protobuf")
        return side

    def _read_small(self) -> None:
        for location in self.index.small:
            try:
                content = read_record(self._file, location, MAX_SMALL_RECORD)
                if location.opcode == Opcode.ATTACHMENT:
                    attachment = Attachment.parse(content)
                    self.attachments[attachment.name] = attachment.data
                elif (record := Metadata.parse(content)).name == "fringed":
                    self.metadata = record.values
            except DamageError as error:
                self.add_problem(f"damaged at byte {location.offset}: {error}")
        version = self.metadata.get("version", VERSION)
        if version != VERSION:
            raise TakeError(f"{self.path}: take version {version!r:.20}, this program reads version {VERSION}")

    def add_problem(self, problem: str) -> None:
        """Add a problem, once."""
        if len(self.problems) < _MAX_PROBLEMS and problem not in self.problems:
            self.problems.append(problem)
