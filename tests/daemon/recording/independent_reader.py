"""Reads a take with mcap and protobuf alone: what a stranger writes after reading the format's page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader


def read(path: Path) -> dict[str, Any]:
    """Attachments, metadata, and the frames as (topic, sequence, publish, log, RawImage, array)."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        kinds = {s.id: message_class(s.name, s.data) for s in summary.schemas.values() if s.encoding == "protobuf"}
        frames = []
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert channel.message_encoding == "protobuf"
            assert schema is not None
            image = kinds[schema.id].FromString(message.data)
            frames.append(
                (channel.topic, message.sequence, message.publish_time, message.log_time, image, pixels(image))
            )
        return {
            "frames": frames,
            "chunks": len(summary.chunk_indexes),
            "schemas": [s.name for s in summary.schemas.values()],
            "attachments": {a.name: (a.media_type, a.data) for a in reader.iter_attachments()},
            "metadata": {m.name: dict(m.metadata) for m in reader.iter_metadata()},
        }


def message_class(name: str, data: bytes) -> Any:
    """The class of messages that the file's own schema describes."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def pixels(image: Any) -> np.ndarray[Any, Any]:
    """The image of a RawImage, rows possibly padded."""
    item = np.dtype("<u2" if image.encoding == "mono16" else "u1")
    channels = 3 if image.encoding == "rgb8" else 1
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
    rows = np.ascontiguousarray(rows[:, : image.width * channels * item.itemsize]).view(item)
    return rows.reshape((image.height, image.width, channels) if channels == 3 else (image.height, image.width))
