"""Pixel formats: conversion of a buffer to a frame's image, in one copy.

Colour becomes ``rgb8`` or an 8-bit mosaic, grey ``mono8`` or ``mono16`` scaled to its 16 bits. Deeper mosaics lose
their lower bits, with a note.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.v4l2 import structs as v

Image = NDArray[np.uint8] | NDArray[np.uint16]
Bytes = memoryview


class CorruptFrame(ValueError):
    """The bytes are not a valid image; ``reason`` is the counter's name."""

    def __init__(self, reason: str, message: str) -> None:
        self.reason = reason
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of an image in a buffer: (width, height) in pixels, bytes from row to row."""

    size: tuple[int, int]
    row_bytes: int

    def rows(self, data: Bytes, pixel_bytes: int) -> NDArray[np.uint8]:
        """Return the (H, width * pixel_bytes) bytes of the image without the rows' padding, as a view."""
        width, height = self.size
        used = width * pixel_bytes
        stride = max(self.row_bytes, used)
        needed = stride * (height - 1) + used
        if len(data) < needed:
            raise CorruptFrame("short_frames", f"{len(data)} bytes, an image of this size has {needed}")
        flat = np.frombuffer(data, np.uint8, needed)
        return np.lib.stride_tricks.as_strided(flat, (height, used), (stride, 1), writeable=False)


Convert = Callable[[Bytes, Layout], Image]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A supported pixel format.

    Args:
        fourcc: the kernel's name; alias: the name in its documentation; encoding: of the frames.
        convert: makes a new image; note: what is lost.
    """

    fourcc: str
    alias: str
    encoding: str
    convert: Convert
    note: str = ""


def _same(channels: int, reverse: bool = False) -> Convert:
    def convert(data: Bytes, layout: Layout) -> Image:
        rows = layout.rows(data, channels)
        if channels == 1:
            return rows.copy()
        pixels = rows.reshape(layout.size[1], layout.size[0], channels)
        return np.ascontiguousarray(pixels[..., ::-1]) if reverse else pixels.copy()

    return convert


def _samples(data: Bytes, layout: Layout) -> NDArray[np.uint16]:
    """16-bit pixels, little-endian; possibly a view into the buffer."""
    return np.ascontiguousarray(layout.rows(data, 2)).view("<u2")


def _grey(bits: int) -> Convert:
    """Repeat the value's top bits below it, so that white is 65535 at every depth."""

    def convert(data: Bytes, layout: Layout) -> Image:
        samples = _samples(data, layout)
        if bits == 16:
            return samples.astype(np.uint16)
        return (samples << np.uint16(16 - bits)) | (samples >> np.uint16(2 * bits - 16))

    return convert


def _deep_mosaic(bits: int) -> Convert:
    def convert(data: Bytes, layout: Layout) -> Image:
        top: NDArray[np.uint16] = _samples(data, layout) >> np.uint16(bits - 8)
        return np.minimum(top, np.uint16(255)).astype(np.uint8)

    return convert


def _packed_yuv(name: str) -> Convert:
    def convert(data: Bytes, layout: Layout) -> Image:
        import cv2

        width, height = layout.size
        pixels = np.ascontiguousarray(layout.rows(data, 2)).reshape(height, width, 2)
        return np.asarray(cv2.cvtColor(pixels, getattr(cv2, f"COLOR_YUV2RGB_{name}")), np.uint8)

    return convert


def _jpeg(data: Bytes, layout: Layout) -> Image:
    import cv2

    raw = bytes(data).rstrip(b"\0")  # cameras pad to a whole packet
    if not raw.startswith(b"\xff\xd8") or b"\xff\xd9" not in raw[-64:]:
        # A decoder would silently fill the missing part of the image with grey.
        raise CorruptFrame("corrupt_jpeg", f"{len(raw)} bytes do not begin and end like a JPEG")
    try:
        image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise CorruptFrame("corrupt_jpeg", str(error)) from error
    if image is None or image.shape[1::-1] != layout.size:
        raise CorruptFrame("corrupt_jpeg", f"{len(raw)} bytes cannot be decoded to {layout.size}")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


_YUV_NOTE = "colours have half the resolution across (4:2:2)"
_JPEG_NOTE = "JPEG loses detail, which fringes need; prefer an uncompressed format or a mosaic"


def _mosaics() -> list[PixelFormat]:
    names = {
        "rggb": ("RGGB", "RG10", "RG12", "RG16"),
        "grbg": ("GRBG", "BA10", "BA12", "GR16"),
        "gbrg": ("GBRG", "GB10", "GB12", "GB16"),
        "bggr": ("BA81", "BG10", "BG12", "BYR2"),
    }
    mosaics = []
    for order, codes in names.items():
        for code, bits in zip(codes, (8, 10, 12, 16), strict=True):
            convert = _same(1) if bits == 8 else _deep_mosaic(bits)
            note = "" if bits == 8 else f"the mosaic's {bits} bits are reduced to 8"
            mosaics.append(PixelFormat(code, f"S{order.upper()}{bits}", f"bayer_{order}8", convert, note))
    return mosaics


FORMATS: dict[str, PixelFormat] = {
    form.fourcc: form
    for form in (
        *_mosaics(),
        PixelFormat("RGB3", "RGB24", "rgb8", _same(3)),
        PixelFormat("BGR3", "BGR24", "rgb8", _same(3, reverse=True)),
        PixelFormat("YUYV", "YUYV", "rgb8", _packed_yuv("YUYV"), _YUV_NOTE),
        PixelFormat("UYVY", "UYVY", "rgb8", _packed_yuv("UYVY"), _YUV_NOTE),
        PixelFormat("MJPG", "MJPEG", "rgb8", _jpeg, _JPEG_NOTE),
        PixelFormat("GREY", "GREY", "mono8", _same(1)),
        PixelFormat("Y10", "Y10", "mono16", _grey(10)),
        PixelFormat("Y12", "Y12", "mono16", _grey(12)),
        PixelFormat("Y16", "Y16", "mono16", _grey(16)),
    )
}
"""The supported formats, the best for measuring in colour first."""


def named(name: str) -> PixelFormat | None:
    """Return the format of a four-letter code or of its name in the kernel's documentation."""
    key = name.strip().upper()
    return next((form for form in FORMATS.values() if key in (form.fourcc, form.alias)), None)


def colour_note(pix: v.PixelFormat) -> str:
    """Return a note when the camera's luma and chroma are not those of the conversion (BT.601, limited range)."""
    other = pix.ycbcr_enc not in (v.YCBCR_ENC_DEFAULT, v.YCBCR_ENC_601)
    other |= pix.ycbcr_enc == v.YCBCR_ENC_DEFAULT and pix.colorspace == v.COLORSPACE_REC709
    if other or pix.quantization == v.QUANTIZATION_FULL_RANGE:
        return "colours are converted as BT.601 of limited range, but the camera reports another kind"
    return ""
