"""Pixel formats: conversion of a camera's data to the encodings of a frame.

A frame's encodings are ``mono8``, ``mono16``, ``rgb8`` and 8-bit Bayer patterns. Grey values of 10, 12 and 14 bits
become ``mono16`` with full scale 65535: the bits are repeated below, so 0 stays 0, full scale becomes 65535 and
nothing lies more than one step of 16 bits from the exact ratio. Bayer values of 10 and 12 bits become 8 bits,
``round(255 v / full scale)``.

Codes and layouts are those of the PFNC (Pixel Format Naming Convention) and, for ``...Packed``, of GigE Vision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Samples = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """One format.

    Args:
        code: of the PFNC; depth: bits of a value; bits: that a pixel takes in memory.
        encoding: of the frame.
        packing: ``plain``, ``p`` (values follow each other bit by bit) or ``packed`` (GigE Vision's order).
    """

    name: str
    code: int
    depth: int
    encoding: str
    packing: str = "plain"

    @property
    def bits(self) -> int:
        """Bits of a pixel in memory, which are part of the code."""
        return self.code >> 16 & 0xFF

    @property
    def reduced(self) -> bool:
        """Whether values lose bits in the conversion."""
        return self.depth > 8 and self.encoding != "mono16"

    def line_bytes(self, width: int) -> int:
        """Bytes of a line of pixels without padding, rounded up."""
        return (width * self.bits + 7) // 8

    def frame_shape(self, width: int, height: int) -> tuple[int, ...]:
        """Shape of the frame's image."""
        return (height, width, 3) if self.encoding == "rgb8" else (height, width)

    @property
    def dtype(self) -> type[np.uint8] | type[np.uint16]:
        """Type of the frame's values."""
        return np.uint16 if self.encoding == "mono16" else np.uint8


_PATTERNS = {"RG": "bayer_rggb8", "GR": "bayer_grbg8", "GB": "bayer_gbrg8", "BG": "bayer_bggr8"}
_BAYER_CODES = {
    "8": (8, "plain", {"GR": 0x01080008, "RG": 0x01080009, "GB": 0x0108000A, "BG": 0x0108000B}),
    "10": (10, "plain", {"GR": 0x0110000C, "RG": 0x0110000D, "GB": 0x0110000E, "BG": 0x0110000F}),
    "12": (12, "plain", {"GR": 0x01100010, "RG": 0x01100011, "GB": 0x01100012, "BG": 0x01100013}),
    "10p": (10, "p", {"BG": 0x010A0052, "GB": 0x010A0054, "GR": 0x010A0056, "RG": 0x010A0058}),
    "12p": (12, "p", {"BG": 0x010C0053, "GB": 0x010C0055, "GR": 0x010C0057, "RG": 0x010C0059}),
    "10Packed": (10, "packed", {"GR": 0x010C0026, "RG": 0x010C0027, "GB": 0x010C0028, "BG": 0x010C0029}),
    "12Packed": (12, "packed", {"GR": 0x010C002A, "RG": 0x010C002B, "GB": 0x010C002C, "BG": 0x010C002D}),
}
_ALL = [
    PixelFormat("Mono8", 0x01080001, 8, "mono8"),
    PixelFormat("Mono10", 0x01100003, 10, "mono16"),
    PixelFormat("Mono12", 0x01100005, 12, "mono16"),
    PixelFormat("Mono14", 0x01100025, 14, "mono16"),
    PixelFormat("Mono16", 0x01100007, 16, "mono16"),
    PixelFormat("Mono10p", 0x010A0046, 10, "mono16", "p"),
    PixelFormat("Mono12p", 0x010C0047, 12, "mono16", "p"),
    PixelFormat("Mono10Packed", 0x010C0004, 10, "mono16", "packed"),
    PixelFormat("Mono12Packed", 0x010C0006, 12, "mono16", "packed"),
    PixelFormat("RGB8", 0x02180014, 8, "rgb8"),
    PixelFormat("BGR8", 0x02180015, 8, "rgb8"),
    *(
        PixelFormat(f"Bayer{pattern}{kind}", code, depth, _PATTERNS[pattern], packing)
        for kind, (depth, packing, codes) in _BAYER_CODES.items()
        for pattern, code in codes.items()
    ),
]
BY_NAME: dict[str, PixelFormat] = {form.name: form for form in _ALL} | {
    old: next(form for form in _ALL if form.name == name)
    for old, name in (("RGB8Packed", "RGB8"), ("BGR8Packed", "BGR8"))
}
BY_CODE: dict[int, PixelFormat] = {form.code: form for form in _ALL}


def convert(raw: Bytes, pixels: PixelFormat, width: int, height: int, out: NDArray[Any], *, padding: int = 0) -> None:
    """Convert a camera's bytes to a frame's image.

    Args:
        raw: (N,) uint8 of the image alone. padding: bytes after each line.
        out: array of ``pixels.frame_shape`` and ``pixels.dtype`` to fill.

    Raises:
        ValueError: there are fewer bytes than the image needs.
    """
    line = pixels.line_bytes(width)
    whole = (width * height * pixels.bits + 7) // 8
    needed = (line + padding) * (height - 1) + line if padding else whole
    if raw.size < needed:
        raise ValueError(f"a {pixels.name} image of {width} x {height} has {needed} bytes; {raw.size} came")
    if padding:
        lines = np.lib.stride_tricks.as_strided(raw, (height, line), (line + padding, 1), writeable=False)
        raw = np.ascontiguousarray(lines).reshape(-1)
        if width * pixels.bits % 8:
            for y in range(height):
                convert(raw[y * line : (y + 1) * line], pixels, width, 1, out[y : y + 1])
            return
    if pixels.depth == 8:
        _bytes(raw[:whole], pixels, out)
        return
    values = _values(raw[:whole], pixels, width * height).reshape(height, width)
    if pixels.encoding != "mono16":
        cv2.convertScaleAbs(values, dst=out, alpha=255 / ((1 << pixels.depth) - 1))
        return
    np.left_shift(values, 16 - pixels.depth, out=out)
    if pixels.depth < 16:
        np.bitwise_or(out, values >> (2 * pixels.depth - 16), out=out)


def _bytes(raw: Bytes, pixels: PixelFormat, out: Bytes) -> None:
    image = raw.reshape(out.shape)
    if pixels.name == "BGR8":
        cv2.cvtColor(image, cv2.COLOR_BGR2RGB, dst=out)
    else:
        out[...] = image


def _values(raw: Bytes, pixels: PixelFormat, count: int) -> Samples:
    """(count,) values of more than 8 bits."""
    if pixels.packing == "plain":
        samples: Samples = raw.view("<u2") if raw.ctypes.data % 2 == 0 else raw.copy().view("<u2")
        return samples[:count]
    unpack, per_group, group_bytes = _UNPACK[pixels.packing, pixels.depth]
    groups = -(-count // per_group)
    if raw.size < groups * group_bytes:
        raw = np.concatenate([raw, np.zeros(groups * group_bytes - raw.size, np.uint8)])
    out = np.empty((groups, per_group), np.uint16)
    unpack(raw[: groups * group_bytes].reshape(groups, group_bytes).T, out.T)
    return out.reshape(-1)[:count]


def _unpack_12p(b: Bytes, out: Samples) -> None:
    low, middle, high = (part.astype(np.uint16) for part in b)
    out[0] = low | (middle & 0x0F) << 8
    out[1] = middle >> 4 | high << 4


def _unpack_10p(b: Bytes, out: Samples) -> None:
    a, c, d, e, f = (part.astype(np.uint16) for part in b)
    out[0] = a | (c & 0x03) << 8
    out[1] = c >> 2 | (d & 0x0F) << 6
    out[2] = d >> 4 | (e & 0x3F) << 4
    out[3] = e >> 6 | f << 2


def _unpack_12packed(b: Bytes, out: Samples) -> None:
    first, both, second = (part.astype(np.uint16) for part in b)
    out[0] = first << 4 | both & 0x0F
    out[1] = second << 4 | both >> 4


def _unpack_10packed(b: Bytes, out: Samples) -> None:
    first, both, second = (part.astype(np.uint16) for part in b)
    out[0] = first << 2 | both & 0x03
    out[1] = second << 2 | both >> 4 & 0x03


_UNPACK: dict[tuple[str, int], tuple[Callable[[Bytes, Samples], None], int, int]] = {
    ("p", 12): (_unpack_12p, 2, 3),
    ("p", 10): (_unpack_10p, 4, 5),
    ("packed", 12): (_unpack_12packed, 2, 3),
    ("packed", 10): (_unpack_10packed, 2, 3),
}
