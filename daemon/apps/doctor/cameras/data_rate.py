"""The cameras' transport and data rate."""

from __future__ import annotations

from daemon.apps.doctor.subject import Size, Subject
from drivers.genicam.options import Options as GenicamOptions
from drivers.protocols import SIDES, Side
from drivers.v4l2 import formats
from drivers.v4l2.options import Options as V4l2Options
from pipeline.common.errors import PipelineError

_BYTES = {"rgb": 3.0, "bgr": 3.0, "yuyv": 2.0, "uyvy": 2.0, "y16": 2.0, "mjpg": 3.0}


def transport_used(subject: Subject, kind: str) -> bool | None:
    """Whether a connected camera uses a transport (``GEV``, ``U3V``); None if no camera reports its transport."""
    kinds = {camera.transport.upper() for camera in subject.genicam} - {"", "CUSTOM", "MIXED"}
    return kind in kinds if kinds else (False if subject.genicam else None)


def image_size(subject: Subject, side: Side) -> Size | None:
    """(width, height) of a camera's images, None if the files do not determine it."""
    if subject.simulation is not None:
        width, height = subject.simulation.layout.camera_size
        return int(width), int(height)
    options = subject.cameras.get(side)
    if isinstance(options, GenicamOptions) and options.roi is not None:
        return options.roi.width, options.roi.height
    if isinstance(options, V4l2Options) and options.size is not None:
        return options.size
    try:
        file = subject.calibration
    except PipelineError:
        return None
    return None if file is None else (file.calibration.left if side == "left" else file.calibration.right).size


def pixel_bytes(subject: Subject, side: Side) -> float:
    """Bytes per pixel on the transport; 1, as of Bayer images, if the format is unknown."""
    name = _format_name(subject, side)
    if name.endswith(("10p", "12p", "10packed", "12packed")):
        return 1.5
    if name.endswith(("10", "12", "14", "16")):
        return 2.0
    return next((count for start, count in _BYTES.items() if name.startswith(start)), 1.0)


def is_mosaic(subject: Subject, side: Side) -> bool:
    """Whether a camera's images are colour mosaics according to the files."""
    name = _format_name(subject, side)
    v4l2 = formats.named(name) if isinstance(subject.cameras.get(side), V4l2Options) else None
    return (name if v4l2 is None else v4l2.encoding).startswith("bayer")


def _format_name(subject: Subject, side: Side) -> str:
    """The pixel format in the files, in small letters, empty if they name none."""
    options = subject.cameras.get(side)
    name: str | None = subject.simulation.encoding if subject.simulation is not None else None
    if options is not None:
        name = options.pixel_format if isinstance(options, GenicamOptions) else options.format
    return (name or "").lower()


def frame_bytes(subject: Subject) -> list[int]:
    """Bytes of a left and of a right image; empty if a size is unknown."""
    sizes = [image_size(subject, side) for side in SIDES]
    return [
        round(size[0] * size[1] * pixel_bytes(subject, side))
        for side, size in zip(SIDES, sizes, strict=True)
        if size is not None and all(sizes)
    ]


def rate_hz(subject: Subject) -> float:
    """Pairs per second according to rig.yaml, 0 if an external trigger determines the rate."""
    if subject.simulation is not None:
        return float(subject.simulation.rate_hz)
    rates = []
    for options in subject.cameras.values():
        if isinstance(options, V4l2Options):
            rates.append(options.frame_rate_hz or 0.0)
        elif options.trigger.source == "software":
            rates.append(options.trigger.rate_hz)
    return float(max(rates, default=0.0))
