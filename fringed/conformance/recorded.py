"""The recorded messages: files of frames, and their expected decoding."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from importlib import resources
from typing import Any

import msgspec
import numpy as np

from fringed import wire
from fringed.errors import WireError

Frames = list[bytes]


def pack(messages: Sequence[Sequence[bytes]]) -> bytes:
    """Encode messages as a file: for each the number of its frames, then of each frame its length and its bytes.

    All numbers have four bytes, little-endian.
    """
    out = bytearray()
    for frames in messages:
        out += len(frames).to_bytes(4, "little")
        for frame in frames:
            out += len(frame).to_bytes(4, "little") + bytes(frame)
    return bytes(out)


def unpack(data: bytes) -> Iterator[Frames]:
    """Yield the messages of a file."""
    at = 0

    def number() -> int:
        nonlocal at
        at += 4
        return int.from_bytes(data[at - 4 : at], "little")

    while at < len(data):
        frames = []
        for _ in range(number()):
            size = number()
            frames.append(data[at : at + size])
            at += size
        yield frames


def messages(name: str) -> list[Frames]:
    """Return the recorded messages ``valid`` or ``refused``."""
    return list(unpack(_file(f"{name}.bin").read_bytes()))


def exchanges() -> list[dict[str, Any]]:
    """Return the recorded requests of control with their responses."""
    rows: list[dict[str, Any]] = json.loads(_file("control.json").read_text(encoding="utf-8"))
    return rows


def expected() -> dict[str, Any]:
    """Return what a client must make of the recorded messages."""
    values: dict[str, Any] = json.loads(_file("expected.json").read_text(encoding="utf-8"))
    return values


def decoded(frames: Sequence[Any], rays: Any = None) -> dict[str, Any]:
    """Return a message as the kit expects it from a client.

    Args:
        frames: of one message; rays: (H, W, 2) of ``meta/rays``, for ``cloud/depth``.

    Raises:
        WireError: the message violates the format.
    """
    message = wire.decode(frames)
    header: dict[str, Any] = msgspec.to_builtins(message.header)
    parts = {
        name: {
            "dtype": array.dtype.str,
            "shape": list(array.shape),
            "sha256": hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest(),
        }
        for name, array in message.arrays.items()
    }
    row: dict[str, Any] = {
        "topic": message.topic,
        "header": {key: header[key] for key in header if key != "parts"},
        "parts": parts,
    }
    xyz = message.arrays.get("xyz")
    if "z" in message.arrays and rays is not None:
        part, stored = message.part("z"), message.arrays["z"]
        if not isinstance(part.scale, float) or not isinstance(part.offset, float):
            raise WireError(f"{message.topic}: part 'z' needs scale and offset")
        z = np.where(stored == 0, np.nan, stored.astype(np.float64) * part.scale + part.offset)
        xyz = np.dstack([rays * z[..., None], z])
    if xyz is not None:
        points = xyz[np.isfinite(xyz[..., 2])]
        row |= {"points": len(points), "mean_mm": [round(float(value), 4) for value in points.mean(axis=0)]}
    return row


def _file(name: str) -> Any:
    return resources.files("fringed.conformance") / "streams" / name
