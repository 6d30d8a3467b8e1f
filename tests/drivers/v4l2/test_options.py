"""Options of a camera: what is taken, and every refusal with its key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.protocols import Camera
from drivers.v4l2 import open_camera
from drivers.v4l2.options import from_mapping


def test_every_option() -> None:
    options = from_mapping(
        "left",
        {
            "device": "/dev/v4l/by-id/usb-camera",
            "size": [1280, 720],
            "format": "YUYV",
            "frame_rate_hz": 30,
            "controls": {"auto_exposure": "manual", "exposure_time_absolute": 100, "dynamic": False},
            "buffers": 12,
            "trigger": "hardware",
            "end_of_frame_delay_us": 500,
        },
    )
    assert options.size == (1280, 720) and options.frame_rate_hz == 30.0 and options.buffers == 12


def test_a_camera_is_made_closed() -> None:
    camera = open_camera("right", {"device": "/dev/not-there"}, Path())
    assert isinstance(camera, Camera)
    camera.close()


@pytest.mark.parametrize(
    ("change", "key", "message"),
    [
        ({"device": None}, "device", "expected `str`"),
        ({"device": " "}, "device", "is empty"),
        ({"devise": "x"}, "devise", "did you mean 'device'?"),
        ({"size": [640]}, "size", "expected `array`"),
        ({"size": [640, "480"]}, "size[1]", "got '480'"),
        ({"size": [640, 0]}, "size", "expected two even numbers"),
        ({"format": "H264"}, "format", "YUYV"),
        ({"frame_rate_hz": 0}, "frame_rate_hz", "expected 0.01"),
        ({"buffers": 1}, "buffers", "expected 2 to 32"),
        ({"buffers": "8"}, "buffers", "got '8'"),
        ({"controls": {"gain": [1]}}, "controls", "got"),
        ({"controls": {"gain": 1 << 40}}, "controls.gain", "32 bits"),
        ({"trigger": "wire"}, "trigger", "got 'wire'"),
        ({"trigger": "software"}, "trigger", "only_still_scenes: true"),
        ({"end_of_frame_delay_us": -1}, "end_of_frame_delay_us", "expected 0"),
    ],
)
def test_every_mistake_names_its_key(change: dict[str, Any], key: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        open_camera("right", {"device": "/dev/video0", **change}, Path())
    text = str(caught.value)
    assert text.startswith(f"cameras.right.{key}") and message in text


def test_a_device_is_demanded() -> None:
    with pytest.raises(ValueError, match=r"^cameras\.left\.device: is missing"):
        open_camera("left", {}, Path())


def test_software_timing_is_taken_when_nothing_moves() -> None:
    options = from_mapping("left", {"device": "/dev/video0", "trigger": "software", "only_still_scenes": True})
    assert options.trigger == "software"
