"""The structures, numbers and codes are those of the C header of this machine."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from drivers.v4l2 import formats
from drivers.v4l2 import structs as v

STRUCTURES = {
    "v4l2_capability": v.Capability,
    "v4l2_fmtdesc": v.FormatDescription,
    "v4l2_pix_format": v.PixelFormat,
    "v4l2_format": v.Format,
    "v4l2_fract": v.Fraction,
    "v4l2_captureparm": v.CaptureParameters,
    "v4l2_streamparm": v.StreamParameters,
    "v4l2_frmsizeenum": v.FrameSize,
    "v4l2_requestbuffers": v.RequestBuffers,
    "v4l2_buffer": v.Buffer,
    "v4l2_exportbuffer": v.ExportBuffer,
    "v4l2_control": v.Control,
    "v4l2_query_ext_ctrl": v.QueryControl,
    "v4l2_querymenu": v.QueryMenu,
}
FIELDS = {
    "timestamp_s": "timestamp.tv_sec", "timestamp_us": "timestamp.tv_usec", "offset": "m.offset", "size": "discrete",
    "entry": "name",
}  # fmt: skip
REQUESTS = (
    "QUERYCAP", "ENUM_FMT", "G_FMT", "S_FMT", "REQBUFS", "QUERYBUF", "QBUF", "EXPBUF", "DQBUF", "STREAMON", "STREAMOFF",
    "G_PARM", "S_PARM", "G_CTRL", "S_CTRL", "QUERYMENU", "ENUM_FRAMESIZES", "QUERY_EXT_CTRL",
)  # fmt: skip
CONSTANTS = {
    "V4L2_BUF_TYPE_VIDEO_CAPTURE": v.VIDEO_CAPTURE,
    "V4L2_MEMORY_MMAP": v.MEMORY_MMAP,
    "V4L2_FIELD_NONE": v.FIELD_NONE,
    "V4L2_CAP_VIDEO_CAPTURE": v.CAP_VIDEO_CAPTURE,
    "V4L2_CAP_VIDEO_CAPTURE_MPLANE": v.CAP_VIDEO_CAPTURE_MPLANE,
    "V4L2_CAP_STREAMING": v.CAP_STREAMING,
    "V4L2_CAP_DEVICE_CAPS": v.CAP_DEVICE_CAPS,
    "V4L2_CAP_TIMEPERFRAME": v.CAP_TIMEPERFRAME,
    "V4L2_BUF_FLAG_ERROR": v.BUF_FLAG_ERROR,
    "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC": v.BUF_FLAG_TIMESTAMP_MONOTONIC,
    "V4L2_BUF_FLAG_TSTAMP_SRC_SOE": v.BUF_FLAG_TSTAMP_SRC_SOE,
    "V4L2_CTRL_FLAG_DISABLED": v.CTRL_FLAG_DISABLED,
    "V4L2_CTRL_FLAG_READ_ONLY": v.CTRL_FLAG_READ_ONLY,
    "V4L2_CTRL_FLAG_INACTIVE": v.CTRL_FLAG_INACTIVE,
    "V4L2_CTRL_FLAG_WRITE_ONLY": v.CTRL_FLAG_WRITE_ONLY,
    "V4L2_CTRL_FLAG_NEXT_CTRL": v.CTRL_FLAG_NEXT_CTRL,
    "V4L2_CID_EXPOSURE_AUTO": v.CID_EXPOSURE_AUTO,
    "V4L2_CID_EXPOSURE_ABSOLUTE": v.CID_EXPOSURE_ABSOLUTE,
    "V4L2_EXPOSURE_MANUAL": v.EXPOSURE_AUTO_MANUAL,
    "V4L2_EXPOSURE_SHUTTER_PRIORITY": v.EXPOSURE_AUTO_SHUTTER_PRIORITY,
    "V4L2_FRMSIZE_TYPE_DISCRETE": v.FRAME_SIZE_DISCRETE,
    "V4L2_YCBCR_ENC_DEFAULT": v.YCBCR_ENC_DEFAULT,
    "V4L2_YCBCR_ENC_601": v.YCBCR_ENC_601,
    "V4L2_QUANTIZATION_FULL_RANGE": v.QUANTIZATION_FULL_RANGE,
    "V4L2_COLORSPACE_REC709": v.COLORSPACE_REC709,
}


@pytest.fixture(scope="module")
def header(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """Sizes and offsets of <linux/videodev2.h> from a C program."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or not Path("/usr/include/linux/videodev2.h").exists():
        reason = "a C compiler and linux/videodev2.h are needed (packages gcc, linux-libc-dev)"
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)
    wanted = [f"VIDIOC_{name}" for name in REQUESTS] + list(CONSTANTS)
    wanted += [f"V4L2_PIX_FMT_{form.alias}" for form in formats.FORMATS.values()]
    for name, structure in STRUCTURES.items():
        wanted.append(f"sizeof(struct {name})")
        wanted += [f"offsetof(struct {name}, {field})" for field in c_fields(structure)]
    lines = "".join(f'  printf(", \\"%s\\": %llu\\n", "{text}", (unsigned long long) ({text}));\n' for text in wanted)
    folder = tmp_path_factory.mktemp("header")
    (folder / "header.c").write_text(
        "#include <stddef.h>\n#include <stdio.h>\n#include <linux/videodev2.h>\n"
        f'int main(void) {{\n  printf("{{\\"\\": 0");\n{lines}  printf("}}");\n}}\n'
    )
    subprocess.run([compiler, "-o", folder / "header", folder / "header.c"], check=True, timeout=60)
    output = subprocess.run([folder / "header"], check=True, capture_output=True, timeout=10).stdout
    return dict(json.loads(output))


def c_fields(structure: type[ctypes.Structure]) -> dict[str, str]:
    """Our names by those of C, for fields that C names."""
    names = [entry[0] for entry in structure._fields_]
    return {FIELDS.get(name, name): name for name in names if not name.startswith("reserved") or name == "reserved2"}


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_lie_in_memory_as_in_c(header: dict[str, int], name: str) -> None:
    structure = STRUCTURES[name]
    assert ctypes.sizeof(structure) == header[f"sizeof(struct {name})"]
    for there, here in c_fields(structure).items():
        assert getattr(structure, here).offset == header[f"offsetof(struct {name}, {there})"], here


@pytest.mark.parametrize("name", REQUESTS)
def test_requests_have_the_numbers_of_c(header: dict[str, int], name: str) -> None:
    assert getattr(v, name) == header[f"VIDIOC_{name}"] & 0xFFFF_FFFF


def test_constants_are_those_of_c(header: dict[str, int]) -> None:
    assert {name: header[name] for name in CONSTANTS} == CONSTANTS


def test_pixel_formats_have_the_codes_of_c(header: dict[str, int]) -> None:
    for form in formats.FORMATS.values():
        code = header[f"V4L2_PIX_FMT_{form.alias}"]
        assert v.fourcc(form.fourcc) == code
        assert v.fourcc_name(code) == form.fourcc
