"""An unsuitable exposure is reported before the long sequence, with the camera and the remedy."""

from __future__ import annotations

import numpy as np
import pytest

from daemon.apps.calibration.guided.capture import CapturedImages
from daemon.apps.calibration.guided.exposure_check import exposure_problem, full_light

SIZE = (64, 48)


def captured(left: int, right: int, *, encoding: str = "rgb8", dtype: type = np.uint8) -> CapturedImages:
    """A white board of the given levels that fills a third of the image, under each channel's full light."""
    pairs = []
    for channel in range(3):
        pair = []
        for level in (left, right):
            image = np.zeros((*SIZE[::-1], 3) if encoding == "rgb8" else SIZE[::-1], dtype)
            board = image[8:40, 10:40]
            board[...] = np.eye(3, dtype=dtype)[channel] * level if encoding == "rgb8" else level
            pair.append(image)
        pairs.append((pair[0], pair[1]))
    return CapturedImages(encoding, tuple(pairs))


def test_each_channel_is_shown_alone_at_its_maximum() -> None:
    assert [frame.as_mapping()["color"] for frame in full_light((8, 6)).frames] == [
        [255, 0, 0], [0, 255, 0], [0, 0, 255],
    ]  # fmt: skip


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8", "bayer_gbrg8"])
def test_a_good_exposure_has_no_problem(encoding: str) -> None:
    assert exposure_problem(captured(200, 60, encoding=encoding)) == ""


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_saturated_and_dark_images_are_reported_with_the_camera_and_the_remedy(encoding: str) -> None:
    assert exposure_problem(captured(255, 200, encoding=encoding)).startswith(
        "left camera: 100% of the white pixels are saturated"
    )
    assert "right camera: full red light gives 20 counts; increase the exposure time" in exposure_problem(
        captured(200, 20, encoding=encoding)
    )


def test_cameras_without_colour_are_reported() -> None:
    assert "the cameras send mono16" in exposure_problem(captured(200, 200, encoding="mono16", dtype=np.uint16))
    assert "the cameras send mono8" in exposure_problem(captured(200, 200, encoding="mono8"))
