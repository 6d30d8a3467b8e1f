"""What the guest's tests share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.errors import DeviceLost
from drivers.protocols import Frame, Side
from drivers.v4l2 import V4l2Camera, open_camera
from drivers.v4l2.controls import Controls, ControlValue
from drivers.v4l2.device import Device
from drivers.v4l2.kernel import LinuxKernel

DEADLINE_S = 30.0
VIVID, SPARE, MULTIPLANAR = "/dev/video0", "/dev/video1", "/dev/video2"


def camera(device: str, side: Side = "left", **options: Any) -> V4l2Camera:
    return open_camera(side, {"device": device, "size": [320, 180], **options}, Path())


@contextmanager
def acquiring(device: str = VIVID, side: Side = "left", **options: Any) -> Iterator[V4l2Camera]:
    """A camera that has been opened and started; closed at the end."""
    made = camera(device, side, **options)
    made.open()
    try:
        made.start()
        yield made
    finally:
        made.close()


def read(made: V4l2Camera) -> Frame:
    """The next frame, waited for with a deadline."""
    frame = made.read(DEADLINE_S)
    assert frame is not None, f"no frame in {DEADLINE_S} s; {made.health().counters}"
    return frame


def push(controls: Mapping[str, ControlValue], device: str = VIVID) -> None:
    """Set controls from outside of the driver under test, as another program would."""
    opened = Device(LinuxKernel(), device, "the other program")
    try:
        notes = Controls(opened).set_all(controls)
        assert not notes, notes
    except DeviceLost:
        assert "disconnect" in controls
    finally:
        opened.close()
