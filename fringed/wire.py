"""The stream's messages, version 1: ``[topic][header][part 0][part 1]...``.

The header is UTF-8 JSON of at most 4 KiB; parts are little-endian, C order, one for each row of ``header.parts``.
Decoding is strict about everything that determines a size or a type, and ignores unknown keys.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType
from numpy.typing import NDArray

from fringed import codecs
from fringed.errors import WireError
from fringed.shared_memory import SharedMemory

VERSION = 1
MAX_HEADER_BYTES = 4096
MAX_TOPIC_BYTES = 64
MAX_PART_BYTES = 1 << 30
MAX_PARTS = 16
MAX_SIDE = 1 << 30
CODECS = (*codecs.CODECS, "shared")
DTYPES = ("|u1", "<u2", "<u4", "<i2", "<i4", "<f4", "<f8")

Array = NDArray[Any]
Name = Annotated[str, Meta(min_length=1, max_length=64)]
Count = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
Side = Annotated[int, Meta(ge=0, le=MAX_SIDE)]


class Part(Struct, frozen=True, kw_only=True):
    """A row of ``header.parts``; with ``scale``, value = stored * scale + offset, and a stored 0 means unknown."""

    name: Name
    dtype: str
    shape: Annotated[tuple[Side, ...], Meta(max_length=4)]
    codec: str = "none"
    scale: float | UnsetType = UNSET
    offset: float | UnsetType = UNSET
    media: str | UnsetType = UNSET


class Header(Struct, frozen=True, kw_only=True):
    """Header of every message; ``t_ns`` is CLOCK_REALTIME, for clouds the start of exposure."""

    kind: Name
    v: Count = VERSION
    seq: Count = 0
    t_ns: Count = 0
    session: str = ""
    device: str = ""
    calibration: str = ""
    parts: Annotated[tuple[Part, ...], Meta(max_length=MAX_PARTS)] = ()
    data: dict[str, Any] | UnsetType = UNSET


class CloudHeader(Header, frozen=True, kw_only=True):
    """Header of a cloud, organised on the left camera's grid of ``width`` x ``height`` pixels."""

    frame: str = "left"
    unit: str = "mm"
    width: Annotated[int, Meta(gt=0, le=65535)]
    height: Annotated[int, Meta(gt=0, le=65535)]
    stats: dict[str, Any] = {}


class _Version(Struct):
    kind: Name
    v: Count


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """A decoded message; ``arrays`` by name, read-only, in the order of the parts."""

    topic: str
    header: Header
    arrays: dict[str, Array]

    def part(self, name: str) -> Part:
        """Return the row of an array."""
        return next(part for part in self.header.parts if part.name == name)


_KINDS: dict[str, type[Header]] = {"cloud": CloudHeader}
_version_decoder = msgspec.json.Decoder(_Version)
_decoders = {kind: msgspec.json.Decoder(header) for kind, header in _KINDS.items()}
_plain_decoder = msgspec.json.Decoder(Header)


def encode(
    topic: str,
    header: Header,
    arrays: Mapping[str, Array] | None = None,
    *,
    rows: Mapping[str, Mapping[str, Any]] | None = None,
    references: Mapping[str, bytes] | None = None,
) -> list[Any]:
    """Encode a message as frames for ``send_multipart``.

    Args:
        topic: ASCII; header: its ``parts`` are filled in here.
        arrays: by name; uncompressed ones are not copied if they are little-endian and C contiguous.
        rows: further keys of an array's row, by name: ``codec``, ``scale``, ``offset``, ``media``.
        references: to arrays that are in shared memory, by name; the message has these instead.

    Raises:
        WireError: a header over 4 KiB, or an array of an unsupported type.
    """
    parts, bodies = [], []
    for name, array in (arrays or {}).items():
        part, body = _encode_part(name, array, (rows or {}).get(name, {}), (references or {}).get(name))
        parts.append(part)
        bodies.append(body)
    head = msgspec.json.encode(msgspec.structs.replace(header, parts=tuple(parts)))
    if len(head) > MAX_HEADER_BYTES:
        raise WireError(f"{topic}: header of {len(head)} bytes, limit {MAX_HEADER_BYTES}; send large content as a part")
    return [topic.encode("ascii"), head, *bodies]


def decode(frames: Sequence[Any], *, memory: SharedMemory | None = None) -> Message:
    """Decode the message in these frames (bytes, memoryviews or ``zmq.Frame``); its arrays are views of them.

    Args:
        memory: for parts in shared memory, which are copied from there.

    Raises:
        WireError: the message violates the format.
        OverwrittenError, SharedMemoryError: a part cannot be read from shared memory.
        CodecMissingError: a part needs a package that is not installed.
    """
    topic, header = decode_header(frames)
    if len(frames) != 2 + len(header.parts):
        raise WireError(f"{topic}: {len(frames) - 2} parts received, the header lists {len(header.parts)}")
    arrays: dict[str, Array] = {}
    for part, frame in zip(header.parts, frames[2:], strict=True):
        if part.name in arrays:
            raise WireError(f"{topic}: two parts are named {part.name!r}")
        arrays[part.name] = _decode_part(topic, part, _view(frame), memory)
    return Message(topic, header, arrays)


def decode_header(frames: Sequence[Any]) -> tuple[str, Header]:
    """Decode topic and header only; the parts are not checked."""
    if len(frames) < 2:
        raise WireError(f"a message has at least a topic and a header, {len(frames)} frames received")
    return _topic(_view(frames[0])), _header(_view(frames[1]))


def _view(frame: Any) -> memoryview:
    return memoryview(frame if isinstance(frame, bytes | bytearray | memoryview) else frame.buffer)


def _topic(raw: memoryview) -> str:
    try:
        text = raw.tobytes().decode("ascii") if len(raw) <= MAX_TOPIC_BYTES else ""
    except UnicodeDecodeError:
        text = ""
    if not text:
        raise WireError(f"the topic is not 1 to {MAX_TOPIC_BYTES} ASCII characters ({len(raw)} bytes)")
    return text


def _header(raw: memoryview) -> Header:
    if len(raw) > MAX_HEADER_BYTES:
        raise WireError(f"header of {len(raw)} bytes, limit {MAX_HEADER_BYTES}")
    try:
        text = raw.tobytes().decode("utf-8")
        version = _version_decoder.decode(text)
        if version.v != VERSION:
            raise WireError(
                f"message version {version.v}; this client supports version {VERSION}: update the fringed package"
            )
        return _decoders.get(version.kind, _plain_decoder).decode(text)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"header: {error}") from None


def _decode_part(topic: str, part: Part, raw: memoryview, memory: SharedMemory | None) -> Array:
    where = f"{topic}, part {part.name!r}"
    if part.dtype not in DTYPES:
        raise WireError(f"{where}: dtype {part.dtype!r} is not one of {', '.join(DTYPES)}")
    if part.codec not in CODECS:
        raise WireError(f"{where}: codec {part.codec!r} is not one of {', '.join(CODECS)}")
    dtype = np.dtype(part.dtype)
    size = prod(part.shape) * dtype.itemsize
    if size > MAX_PART_BYTES:
        raise WireError(f"{where}: {size} bytes, limit {MAX_PART_BYTES}")
    body: Any = raw
    if part.codec == "shared":
        if memory is None:
            raise WireError(f"{where}: it is in shared memory; receive it with subscribe(..., shared=True)")
        body = memory.read(raw, size, where)
    elif part.codec != "none":
        body = codecs.decompress(raw, size, where)
    if len(body) != size:
        raise WireError(f"{where}: {len(body)} bytes received, shape {list(part.shape)} of {part.dtype} needs {size}")
    return np.frombuffer(body, dtype).reshape(part.shape)


def _encode_part(name: str, array: Array, row: Mapping[str, Any], reference: bytes | None = None) -> tuple[Part, Any]:
    dtype = array.dtype.newbyteorder("<")
    if dtype.str not in DTYPES:
        raise WireError(f"part {name!r}: dtype {dtype.str!r} is not one of {', '.join(DTYPES)}")
    if reference is not None:
        return Part(name=name, dtype=dtype.str, shape=array.shape, codec="shared"), reference
    flat = np.ascontiguousarray(array, dtype=dtype)
    part = Part(name=name, dtype=dtype.str, shape=array.shape, **row)
    if part.codec == "none":
        return part, flat.data.cast("B") if flat.size else b""
    return part, codecs.compress(flat, part.codec)
