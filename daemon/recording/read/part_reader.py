"""One file of a take: its attachments, and its frames as far as they are sound."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from daemon.recording.format import mcap_chunks
from daemon.recording.format.errors import TakeError
from daemon.recording.format.mcap_index import Survey, read_record, survey
from daemon.recording.format.mcap_records import (
    MAX_SMALL_RECORD,
    Attachment,
    DamageError,
    Message,
    Metadata,
    Opcode,
    Place,
)
from daemon.recording.format.raw_image import ImageError, decode
from drivers.protocols import SIDES, Frame, Side

VERSION = "1"
SCHEMA = "foxglove.RawImage"
_TOPICS: dict[str, Side] = {f"/{side}/image": side for side in SIDES}
_MAX_PROBLEMS = 20


@dataclass(frozen=True, slots=True)
class Where:
    """The place of a message: its chunk, and the offset inside it."""

    place: Place
    at: int


class PartReader:
    """One MCAP file.

    Args:
        path: of the file.

    Raises:
        TakeError: a file that cannot be read, is no recording of ours, or is of a version that is not known.
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
            self.survey: Survey = survey(self._file)
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
        if self.survey.problem:
            self.complain(self.survey.problem)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def counts(self) -> Counter[Side]:
        """Frames by camera, as the file's index or the heads of its chunks tell; none was read."""
        out: Counter[Side] = Counter()
        for channel_id, count in self.survey.messages.items():
            channel = self.survey.channels.get(channel_id)
            side = _TOPICS.get(channel.topic) if channel is not None else None
            if side is not None:
                out[side] += count
        return out

    def frames(self) -> Iterator[tuple[Frame, Where]]:
        """Every frame that is sound, in the order of the file."""
        for place in self.survey.data:
            records = self._load(place)
            if records is None:
                continue
            try:
                for message, at in mcap_chunks.messages(records, self.survey):
                    frame = self._frame(message, place)
                    if frame is not None:
                        yield frame, Where(place, at)
            except DamageError as error:
                self.complain(f"damaged at byte {place.offset}: {error}")

    def frame_at(self, where: Where) -> Frame | None:
        """One frame again, or None if it cannot be read any more."""
        records = self._load(where.place)
        for message, at in mcap_chunks.messages(records, self.survey) if records is not None else ():
            if at == where.at:
                return self._frame(message, where.place)
        return None

    def _load(self, place: Place) -> bytes | memoryview | None:
        try:
            return mcap_chunks.load(self._file, place)
        except DamageError as error:
            self.complain(f"damaged at byte {place.offset}: {error}; its frames are left out")
            return None
        except OSError as error:
            raise TakeError(f"{self.path}: byte {place.offset}: {error}") from error

    def _frame(self, message: Message, place: Place) -> Frame | None:
        side = self._side(message.channel_id, place)
        if side is None:
            return None
        try:
            image = decode(message.data)
        except ImageError as error:
            self.complain(f"damaged at byte {place.offset}: {side} image {message.sequence}: {error}")
            return None
        return Frame(side, message.sequence, message.publish_ns, message.log_ns, image.encoding, image.image)

    def _side(self, channel_id: int, place: Place) -> Side | None:
        """Which camera a channel is of; None for channels of other things."""
        channel = self.survey.channels.get(channel_id)
        if channel is None:
            self.complain(f"damaged at byte {place.offset}: channel {channel_id} is not described")
            return None
        side = _TOPICS.get(channel.topic)
        if side is None:
            return None
        schema = self.survey.schemas.get(channel.schema_id)
        if channel.message_encoding != "protobuf" or schema is None or schema.name != SCHEMA:
            held = f"{schema.name if schema else 'unknown'} as {channel.message_encoding}"
            raise TakeError(f"{self.path}: channel {channel.topic} holds {held:.100}, expected {SCHEMA} as protobuf")
        return side

    def _read_small(self) -> None:
        for place in self.survey.small:
            try:
                content = read_record(self._file, place, MAX_SMALL_RECORD)
                if place.opcode == Opcode.ATTACHMENT:
                    attachment = Attachment.parse(content)
                    self.attachments[attachment.name] = attachment.data
                elif (record := Metadata.parse(content)).name == "fringed":
                    self.metadata = record.values
            except DamageError as error:
                self.complain(f"damaged at byte {place.offset}: {error}")
        version = self.metadata.get("version", VERSION)
        if version != VERSION:
            raise TakeError(f"{self.path}: a take of version {version!r:.20}, this program reads version {VERSION}")

    def complain(self, problem: str) -> None:
        """Note what is wrong, once."""
        if len(self.problems) < _MAX_PROBLEMS and problem not in self.problems:
            self.problems.append(problem)
