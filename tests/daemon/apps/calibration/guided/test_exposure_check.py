"""An exposure that would spoil the colours is told before the long sequence, with the camera and the remedy."""

from __future__ import annotations

import numpy as np
import pytest

from daemon.apps.calibration.guided.capture import Shots
from daemon.apps.calibration.guided.exposure_check import exposure_problem, full_light

SIZE = (64, 48)


def shots(left: int, right: int, *, encoding: str = "rgb8", dtype: type = np.uint8) -> Shots:
    """A white board that fills a third of the image, as bright as told under each channel's full light."""
    pairs = []
    for channel in range(3):
        pair = []
        for level in (left, right):
            image = np.zeros((*SIZE[::-1], 3) if encoding == "rgb8" else SIZE[::-1], dtype)
            board = image[8:40, 10:40]
            board[...] = np.eye(3, dtype=dtype)[channel] * level if encoding == "rgb8" else level
            pair.append(image)
        pairs.append((pair[0], pair[1]))
    return Shots(encoding, tuple(pairs))


def test_what_is_shown_is_each_channel_alone_and_full() -> None:
    assert [frame.as_mapping()["color"] for frame in full_light((8, 6)).frames] == [
        [255, 0, 0], [0, 255, 0], [0, 0, 255],
    ]  # fmt: skip


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8", "bayer_gbrg8"])
def test_a_good_exposure_is_passed(encoding: str) -> None:
    assert exposure_problem(shots(200, 60, encoding=encoding)) == ""


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_clipped_and_dark_images_are_told_with_the_camera_and_the_remedy(encoding: str) -> None:
    assert exposure_problem(shots(255, 200, encoding=encoding)).startswith("left camera: 100% of the white are clipped")
    assert "right camera: full red light gives 20 counts; expose for longer" in exposure_problem(
        shots(200, 20, encoding=encoding)
    )


def test_cameras_without_colour_are_told() -> None:
    assert "the cameras send mono16" in exposure_problem(shots(200, 200, encoding="mono16", dtype=np.uint16))
    assert "the cameras send mono8" in exposure_problem(shots(200, 200, encoding="mono8"))
