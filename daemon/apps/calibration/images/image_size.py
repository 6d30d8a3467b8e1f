"""Width and height from an image file's header: the size is checked before the file is decoded."""

from __future__ import annotations

import struct

_START_OF_FRAME = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}


def image_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) of a PNG, JPEG, TIFF or BMP; None for other formats and truncated headers."""
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            width, height = struct.unpack_from(">II", data, 16)
        elif data.startswith(b"\xff\xd8"):
            width, height = _jpeg(data)
        elif data[:4] in (b"II*\0", b"MM\0*"):
            width, height = _tiff(data)
        elif data.startswith(b"BM"):
            width, height = struct.unpack_from("<ii", data, 18)
        else:
            return None
    except (struct.error, IndexError, KeyError):
        return None
    return int(width), abs(int(height))  # the height of a BMP is negative if its rows run downwards


def _jpeg(data: bytes) -> tuple[int, int]:
    at = 2
    while True:
        if data[at] != 0xFF:
            raise IndexError
        while data[at] == 0xFF:
            at += 1
        marker, at = data[at], at + 1
        if marker in _START_OF_FRAME:
            height, width = struct.unpack_from(">HH", data, at + 3)
            return width, height
        if marker != 0x01 and not 0xD0 <= marker <= 0xD8:  # these markers have no length field
            at += struct.unpack_from(">H", data, at)[0]


def _tiff(data: bytes) -> tuple[int, int]:
    order = "<" if data[:2] == b"II" else ">"
    (first,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, first)
    tags = {}
    for number in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", data, first + 2 + 12 * number)
        if tag in (256, 257):
            (tags[tag],) = struct.unpack_from(order + {1: "B", 3: "H", 4: "I"}[kind], data, first + 10 + 12 * number)
    return tags[256], tags[257]
