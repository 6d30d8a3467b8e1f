"""How the cameras' images come to the machine: which kinds of transport there are, and how much comes."""

from __future__ import annotations

from daemon.apps.doctor.subject import Size, Subject
from drivers.protocols import SIDES, Side
from pipeline.common.errors import PipelineError

_BYTES = {"rgb": 3.0, "bgr": 3.0, "yuyv": 2.0, "uyvy": 2.0, "y16": 2.0, "mjpg": 3.0}


def wanted(subject: Subject, kind: str) -> bool | None:
    """Whether a transport (``GEV``, ``U3V``) is used here; None where no camera tells."""
    kinds = {camera.transport.upper() for camera in subject.genicam} - {"", "CUSTOM", "MIXED"}
    return kind in kinds if kinds else (False if subject.genicam else None)


def image_size(subject: Subject, side: Side) -> Size | None:
    """(width, height) of a camera's images as far as the files tell."""
    if subject.simulation is not None:
        width, height = subject.simulation.layout.camera_size
        return int(width), int(height)
    options = subject.cameras.get(side)
    roi = getattr(options, "roi", None)
    if roi is not None:
        return int(roi.width), int(roi.height)
    size = getattr(options, "size", None)
    if size is not None:
        return int(size[0]), int(size[1])
    try:
        file = subject.calibration
    except PipelineError:
        return None
    return None if file is None else (file.calibration.left if side == "left" else file.calibration.right).size


def pixel_bytes(subject: Subject, side: Side) -> float:
    """Bytes a pixel as the camera sends them; 1, as Bayer images have, where nothing is said."""
    options = subject.cameras.get(side)
    name = (
        subject.simulation.encoding
        if subject.simulation is not None
        else (getattr(options, "pixel_format", None) or getattr(options, "format", None) or "")
    )
    name = name.lower()
    if name.endswith(("10p", "12p", "10packed", "12packed")):
        return 1.5
    if name.endswith(("10", "12", "14", "16")):
        return 2.0
    return next((count for start, count in _BYTES.items() if name.startswith(start)), 1.0)


def frame_bytes(subject: Subject) -> list[int]:
    """Bytes of a left and of a right image; empty where a size is not known."""
    sizes = [image_size(subject, side) for side in SIDES]
    return [
        round(size[0] * size[1] * pixel_bytes(subject, side))
        for side, size in zip(SIDES, sizes, strict=True)
        if size is not None and all(sizes)
    ]


def rate_hz(subject: Subject) -> float:
    """Pairs a second as far as rig.yaml tells, 0 where a wire sets the rate."""
    if subject.simulation is not None:
        return float(subject.simulation.rate_hz)
    rates = []
    for options in subject.cameras.values():
        trigger = getattr(options, "trigger", None)
        if getattr(trigger, "source", "") == "software":
            rates.append(trigger.rate_hz)  # type: ignore[union-attr]
        elif getattr(options, "frame_rate_hz", None):
            rates.append(options.frame_rate_hz)
    return float(max(rates, default=0.0))
