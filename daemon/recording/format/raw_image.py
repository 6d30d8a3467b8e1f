"""foxglove.RawImage messages: the part of protobuf that an image needs, decoded without a copy."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.recording.format.errors import TakeError

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

# encoding -> (type on disk, values a pixel)
ENCODINGS: dict[str, tuple[str, int]] = {
    "rgb8": ("u1", 3),
    "mono8": ("u1", 1),
    "mono16": ("<u2", 1),
    "bayer_rggb8": ("u1", 1),
    "bayer_grbg8": ("u1", 1),
    "bayer_gbrg8": ("u1", 1),
    "bayer_bggr8": ("u1", 1),
}
SIDE_LIMIT = 1 << 15

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


class ImageError(TakeError):
    """A message that is not a valid image, or an image that the message format cannot represent."""


@dataclass(frozen=True, slots=True, eq=False)
class RawImage:
    """An image as the sensor gave it.

    Args:
        t_ns: start of exposure; frame_id: ``left`` or ``right``.
        image: (H, W) or (H, W, 3), uint8 or uint16, read-only.
    """

    t_ns: int
    frame_id: str
    encoding: str
    image: Pixels


def encode(t_ns: int, frame_id: str, encoding: str, image: Pixels) -> bytes:
    """Encode an image as a message; ImageError when image and encoding do not match."""
    return b"".join(pieces(t_ns, frame_id, encoding, image))


def pieces(t_ns: int, frame_id: str, encoding: str, image: Pixels) -> tuple[bytes, memoryview]:
    """Encode an image as two pieces; the second is a view of the pixels, copied only if they have gaps."""
    dtype, channels = _encoding(encoding)
    shape = image.shape[:2] if channels == 1 else (*image.shape[:2], channels)
    if image.shape != shape or image.size == 0 or image.dtype != np.dtype(dtype).newbyteorder("="):
        raise ImageError(f"{frame_id} image: {image.dtype} {image.shape} does not fit the encoding {encoding}")
    height, width = image.shape[:2]
    step = width * channels * np.dtype(dtype).itemsize
    seconds, nanos = divmod(t_ns, 10**9)
    stamp = b"\x08" + _varint(seconds) + b"\x10" + _varint(nanos)
    head = b"".join([b"\x0a", _varint(len(stamp)), stamp, struct.pack("<BIBI", 0x15, width, 0x1D, height)])
    head += _text(4, encoding) + struct.pack("<BI", 0x2D, step) + _text(7, frame_id)
    pixels = np.ascontiguousarray(image, dtype=dtype)
    return head + b"\x32" + _varint(pixels.nbytes), pixels.reshape(-1).view(np.uint8).data


def decode(data: bytes | memoryview) -> RawImage:
    """Decode the image of a message; a read-only view of ``data`` unless its rows are padded.

    Raises:
        ImageError: bytes that are not a RawImage, or sizes that do not match each other.
    """
    try:
        fields = _fields(memoryview(data))
        stamp = _fields(fields.get(1, memoryview(b"")))
        encoding, frame_id = str(fields.get(4, b""), "utf-8"), str(fields.get(7, b""), "utf-8")
        sizes = int(fields.get(2, 0)), int(fields.get(3, 0)), int(fields.get(5, 0))
        t_ns = int(stamp.get(1, 0)) * 10**9 + int(stamp.get(2, 0))
        pixels = memoryview(fields.get(6, b""))
    except (IndexError, struct.error, UnicodeDecodeError, TypeError, ValueError) as error:
        raise ImageError(f"not a RawImage message: {error}") from error
    return RawImage(t_ns, frame_id, encoding, _view(pixels, encoding, *sizes))


def _view(pixels: memoryview, encoding: str, width: int, height: int, step: int) -> Pixels:
    dtype, channels = _encoding(encoding)
    item = np.dtype(dtype).itemsize
    row = width * channels * item
    if not (0 < width <= SIDE_LIMIT and 0 < height <= SIDE_LIMIT):
        raise ImageError(f"image of {width} x {height} pixels: each side must be 1 to {SIDE_LIMIT}")
    if step < row:
        raise ImageError(f"image rows of {step} bytes cannot hold {width} pixels of {encoding} ({row} bytes)")
    if not step * (height - 1) + row <= len(pixels) <= step * height:
        raise ImageError(f"image of {len(pixels)} bytes, expected {height} rows of {step} bytes")
    shape = (height, width) if channels == 1 else (height, width, channels)
    strides = (step, item) if channels == 1 else (step, item * channels, item)
    image: Any = np.ndarray(shape, dtype=dtype, buffer=pixels, strides=strides)
    if step != row or not image.flags.aligned:
        # Compiled kernels need rows without gaps and aligned numbers.
        image = np.array(image, dtype=image.dtype.newbyteorder("="), order="C")
    image.setflags(write=False)
    return image  # type: ignore[no-any-return]


def _encoding(encoding: str) -> tuple[str, int]:
    if encoding not in ENCODINGS:
        raise ImageError(f"image encoding {encoding[:40]!r} is not one of {', '.join(ENCODINGS)}")
    return ENCODINGS[encoding]


def _varint(value: int) -> bytes:
    out = bytearray()
    value &= (1 << 64) - 1
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _text(field: int, value: str) -> bytes:
    data = value.encode()
    return bytes([field << 3 | _BYTES]) + _varint(len(data)) + data


def _read_varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & (1 << 64) - 1, at
    raise ValueError("a number longer than ten bytes")


def _fields(data: memoryview) -> dict[int, Any]:
    """Field number -> value (the last one wins, as in protobuf); unknown fields are kept and ignored."""
    fields: dict[int, Any] = {}
    at = 0
    while at < len(data):
        tag, at = _read_varint(data, at)
        kind = tag & 7
        if kind == _VARINT:
            value, at = _read_varint(data, at)
            fields[tag >> 3] = value
        elif kind == _FIXED32:
            (fields[tag >> 3],) = struct.unpack_from("<I", data, at)
            at += 4
        elif kind == _FIXED64:
            (fields[tag >> 3],) = struct.unpack_from("<Q", data, at)
            at += 8
        elif kind == _BYTES:
            size, at = _read_varint(data, at)
            if size > len(data) - at:
                raise ValueError(f"field {tag >> 3} has a length of {size} bytes, {len(data) - at} are left")
            fields[tag >> 3] = data[at : at + size]
            at += size
        else:
            raise ValueError(f"unknown wire type {kind}")
    return fields
