"""One file of a take: what it carries, whether it is whole, and its messages in the order of the file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from mcap import records as mcap_records
from mcap.opcode import Opcode

from daemon.recording import records
from daemon.recording.errors import TakeError
from daemon.recording.records import CutOff, Message, RecordHead

TOPICS = {"/left/image": "left", "/right/image": "right"}
ATTACHMENT_LIMIT = 64 << 20
SMALL_RECORD_LIMIT = 16 << 20
METADATA_NAME = "fringed"


class PartReader:
    """A file of a take, open.

    Its records are walked once at the start, without reading the pictures; what is cut off at the end is tolerated.

    Args:
        path: of the file.

    Attributes:
        attachments: name -> bytes; metadata: the record ``fringed``.
        truncated_at: offset of the first byte that is lost, None for a whole file.
        messages_promised: number of messages by the file's own statistics, None where there are none.

    Raises:
        TakeError: the file cannot be read, is no MCAP file, or an attachment is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, str] = {}
        self.truncated_at: int | None = None
        self.messages_promised: int | None = None
        self._with_messages: list[RecordHead] = []
        self._sides: dict[int, str] = {}
        self._schemas: dict[int, str] = {}
        try:
            self._file = self.path.open("rb")
        except OSError as error:
            raise TakeError(f"{path}: {error.strerror or error}") from error
        try:
            self._walk()
        except TakeError as error:
            self.close()
            raise TakeError(f"{path}: {error}") from error
        except OSError as error:
            self.close()
            raise TakeError(f"{path}: {error.strerror or error}") from error
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; pictures already read stay valid."""
        self._file.close()

    def _walk(self) -> None:
        size = self.path.stat().st_size
        if self._file.read(len(records.MAGIC)) != records.MAGIC:
            raise TakeError("not an MCAP file (it does not begin like one)")
        held = 0
        try:
            for head in records.heads(self._file, size):
                if head.opcode == Opcode.ATTACHMENT:
                    held += head.length
                    if held > ATTACHMENT_LIMIT:
                        raise TakeError(f"its attachments are larger than {ATTACHMENT_LIMIT} bytes")
                self._note(head)
        except CutOff as cut:
            self.truncated_at = cut.offset

    def _note(self, head: RecordHead) -> None:
        if head.opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            self._with_messages.append(head)
        elif head.opcode == Opcode.ATTACHMENT:
            record = records.attachment(records.content(self._file, head), head.offset)
            self.attachments.setdefault(record.name, record.data)
        elif head.opcode == Opcode.METADATA:
            record = self._small(mcap_records.Metadata, head)
            if record.name == METADATA_NAME:
                self.metadata = dict(record.metadata)
        elif head.opcode == Opcode.STATISTICS:
            self.messages_promised = self._small(mcap_records.Statistics, head).message_count
        elif head.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._learn(head.opcode, records.content(self._file, head, SMALL_RECORD_LIMIT), head.offset)

    def _small(self, kind: Any, head: RecordHead) -> Any:
        return records.parse(kind, records.content(self._file, head, SMALL_RECORD_LIMIT), head.offset)

    def _learn(self, opcode: int, data: bytes | memoryview, offset: int) -> None:
        """Take in a schema or a channel; a channel of ours must carry what the format says."""
        if opcode == Opcode.SCHEMA:
            schema = records.parse(mcap_records.Schema, data, offset)
            self._schemas[schema.id] = schema.name
            return
        channel = records.parse(mcap_records.Channel, data, offset)
        if channel.topic not in TOPICS:
            return
        schema_name = self._schemas.get(channel.schema_id)
        if channel.message_encoding != "protobuf" or schema_name != "foxglove.RawImage":
            raise TakeError(
                f"channel {channel.topic} carries {schema_name} as {channel.message_encoding},"
                " expected foxglove.RawImage as protobuf"
            )
        self._sides[channel.id] = TOPICS[channel.topic]

    def messages(self) -> Iterator[tuple[str, Message]]:
        """(``left`` or ``right``, message) in the order of the file.

        Raises:
            TakeError: at the first damaged chunk, naming the file; what came before it is sound.
        """
        count = 0
        try:
            for head in self._with_messages:
                for message in self._messages_of(head):
                    count += 1
                    if message.channel_id in self._sides:
                        yield self._sides[message.channel_id], message
            if self.truncated_at is None and self.messages_promised not in (None, count):
                raise TakeError(f"it holds {count} messages, its own statistics say {self.messages_promised}")
        except CutOff as cut:
            self.truncated_at = cut.offset
        except TakeError as error:
            raise TakeError(f"{self.path}: {error}") from error
        except OSError as error:
            raise TakeError(f"{self.path}: {error.strerror or error}") from error

    def _messages_of(self, head: RecordHead) -> Iterator[Message]:
        data = records.content(self._file, head)
        if head.opcode == Opcode.MESSAGE:
            yield records.message(memoryview(data), head.offset)
            return
        for opcode, body in records.split_chunk(data, head.offset):
            if opcode == Opcode.MESSAGE:
                yield records.message(body, head.offset)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._learn(opcode, body, head.offset)
