"""The structures and request numbers of the kernel's video interface for single-planar capture.

Layouts are those of 64-bit Linux (linux/videodev2.h); a test compares every size, offset and number with the C header.
"""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_int64, c_uint8, c_uint32, c_uint64
from typing import Final


class Capability(ctypes.Structure):
    """Capabilities of a device: ``v4l2_capability``."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FormatDescription(ctypes.Structure):
    """One pixel format of a device: ``v4l2_fmtdesc``."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class PixelFormat(ctypes.Structure):
    """Size and layout of an image: ``v4l2_pix_format``."""

    _fields_ = tuple(
        (name, c_uint32)
        for name in (
            "width", "height", "pixelformat", "field", "bytesperline", "sizeimage", "colorspace", "priv", "flags",
            "ycbcr_enc", "quantization", "xfer_func",
        )
    )  # fmt: skip


class _FormatUnion(ctypes.Union):
    _fields_ = (("pix", PixelFormat), ("raw_data", c_uint8 * 200), ("_align", c_uint64))


class Format(ctypes.Structure):
    """``v4l2_format``; ``fmt.pix`` for single-planar capture."""

    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class Fraction(ctypes.Structure):
    """``v4l2_fract``."""

    _fields_ = (("numerator", c_uint32), ("denominator", c_uint32))


class CaptureParameters(ctypes.Structure):
    """``v4l2_captureparm``."""

    _fields_ = (
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fraction),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    )


class _ParametersUnion(ctypes.Union):
    _fields_ = (("capture", CaptureParameters), ("raw_data", c_uint8 * 200))


class StreamParameters(ctypes.Structure):
    """``v4l2_streamparm``."""

    _fields_ = (("type", c_uint32), ("parm", _ParametersUnion))


class _DiscreteSize(ctypes.Structure):
    _fields_ = (("width", c_uint32), ("height", c_uint32))


class _StepwiseSize(ctypes.Structure):
    _fields_ = tuple(
        (name, c_uint32) for name in ("min_width", "max_width", "step_width", "min_height", "max_height", "step_height")
    )


class _SizeUnion(ctypes.Union):
    _fields_ = (("discrete", _DiscreteSize), ("stepwise", _StepwiseSize))


class FrameSize(ctypes.Structure):
    """``v4l2_frmsizeenum``; read ``discrete`` when ``type`` is 1."""

    _anonymous_ = ("size",)
    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("size", _SizeUnion),
        ("reserved", c_uint32 * 2),
    )


class RequestBuffers(ctypes.Structure):
    """``v4l2_requestbuffers``; the kernel writes back how many it granted."""

    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    )


class Buffer(ctypes.Structure):
    """``v4l2_buffer``; ``offset`` is the member of its union that mapped memory uses (its low 32 bits)."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("timestamp_s", c_int64),
        ("timestamp_us", c_int64),
        ("timecode", c_uint8 * 16),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("offset", c_uint64),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    )


class ExportBuffer(ctypes.Structure):
    """``v4l2_exportbuffer``."""

    _fields_ = (
        ("type", c_uint32),
        ("index", c_uint32),
        ("plane", c_uint32),
        ("flags", c_uint32),
        ("fd", c_int32),
        ("reserved", c_uint32 * 11),
    )


class Control(ctypes.Structure):
    """``v4l2_control``."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class QueryControl(ctypes.Structure):
    """``v4l2_query_ext_ctrl``."""

    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int64),
        ("maximum", c_int64),
        ("step", c_uint64),
        ("default_value", c_int64),
        ("flags", c_uint32),
        ("elem_size", c_uint32),
        ("elems", c_uint32),
        ("nr_of_dims", c_uint32),
        ("dims", c_uint32 * 4),
        ("reserved", c_uint32 * 32),
    )


class _MenuUnion(ctypes.Union):
    _pack_ = 1
    _fields_ = (("name", c_char * 32), ("value", c_int64))


class QueryMenu(ctypes.Structure):
    """``v4l2_querymenu``: ``name`` of a menu's entry, ``value`` of an integer menu's."""

    _pack_ = 1
    _anonymous_ = ("entry",)
    _fields_ = (("id", c_uint32), ("index", c_uint32), ("entry", _MenuUnion), ("reserved", c_uint32))


def _request(direction: int, number: int, structure: type[ctypes.Structure | ctypes.c_int]) -> int:
    return direction << 30 | ctypes.sizeof(structure) << 16 | ord("V") << 8 | number


_WRITE, _READ, _BOTH = 1, 2, 3

QUERYCAP: Final = _request(_READ, 0, Capability)
ENUM_FMT: Final = _request(_BOTH, 2, FormatDescription)
G_FMT: Final = _request(_BOTH, 4, Format)
S_FMT: Final = _request(_BOTH, 5, Format)
REQBUFS: Final = _request(_BOTH, 8, RequestBuffers)
QUERYBUF: Final = _request(_BOTH, 9, Buffer)
QBUF: Final = _request(_BOTH, 15, Buffer)
EXPBUF: Final = _request(_BOTH, 16, ExportBuffer)
DQBUF: Final = _request(_BOTH, 17, Buffer)
STREAMON: Final = _request(_WRITE, 18, ctypes.c_int)
STREAMOFF: Final = _request(_WRITE, 19, ctypes.c_int)
G_PARM: Final = _request(_BOTH, 21, StreamParameters)
S_PARM: Final = _request(_BOTH, 22, StreamParameters)
G_CTRL: Final = _request(_BOTH, 27, Control)
S_CTRL: Final = _request(_BOTH, 28, Control)
QUERYMENU: Final = _request(_BOTH, 37, QueryMenu)
ENUM_FRAMESIZES: Final = _request(_BOTH, 74, FrameSize)
QUERY_EXT_CTRL: Final = _request(_BOTH, 103, QueryControl)

VIDEO_CAPTURE: Final = 1
"""The buffer type (``V4L2_BUF_TYPE_VIDEO_CAPTURE``)."""

MEMORY_MMAP: Final = 1
FIELD_NONE: Final = 1

CAP_VIDEO_CAPTURE: Final = 0x1
CAP_VIDEO_CAPTURE_MPLANE: Final = 0x1000
CAP_STREAMING: Final = 0x0400_0000
CAP_DEVICE_CAPS: Final = 0x8000_0000
CAP_TIMEPERFRAME: Final = 0x1000

BUF_FLAG_ERROR: Final = 0x40
BUF_FLAG_TIMESTAMP_MASK: Final = 0xE000
BUF_FLAG_TIMESTAMP_MONOTONIC: Final = 0x2000
BUF_FLAG_TSTAMP_SRC_SOE: Final = 0x10000

CTRL_FLAG_DISABLED: Final = 0x1
CTRL_FLAG_READ_ONLY: Final = 0x4
CTRL_FLAG_INACTIVE: Final = 0x10
CTRL_FLAG_WRITE_ONLY: Final = 0x40
CTRL_FLAG_NEXT_CTRL: Final = 0x8000_0000

CID_EXPOSURE_AUTO: Final = 0x009A_0901
CID_EXPOSURE_ABSOLUTE: Final = 0x009A_0902
EXPOSURE_AUTO_MANUAL: Final = 1
EXPOSURE_AUTO_SHUTTER_PRIORITY: Final = 2

FRAME_SIZE_DISCRETE: Final = 1
YCBCR_ENC_DEFAULT: Final = 0
YCBCR_ENC_601: Final = 1
QUANTIZATION_FULL_RANGE: Final = 1
COLORSPACE_REC709: Final = 3


def fourcc(name: str) -> int:
    """The number of a four-letter code; shorter names are filled with blanks."""
    return int.from_bytes(name.ljust(4).encode("ascii"), "little")


def fourcc_name(number: int) -> str:
    """The four letters of a code, without blanks at the end; a big-endian variant (bit 31) gets ``-BE``."""
    name = (number & 0x7FFF_FFFF).to_bytes(4, "little").decode("ascii", "replace").rstrip(" \0")
    return f"{name}-BE" if number >> 31 else name
