"""A bar of known length: its two ends are detected, and its length is measured."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from daemon.cli.command_table import invoke
from pipeline.calibrate.targets.scale_bar import two_circles
from pipeline.common.errors import TargetError
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel
from tests.daemon.apps.calibration import drawn

LENGTH = 150.0
ENDS = np.array([[-62.0, 12.0, 990.0], [0.0, 0.0, 0.0]])
ENDS[1] = ENDS[0] + LENGTH * np.array([0.96, 0.0, 0.28])


def balls(device: CameraModel, seed: int, *, count: int = 2, light: bool = False) -> np.ndarray:
    """Small balls, drawn as discs around the images of their centres, 16 rays a pixel."""
    width, height = device.size
    v, u = (np.mgrid[0 : 4 * height, 0 : 4 * width] + 0.5) / 4 - 0.5
    shade = np.ones((4 * height, 4 * width))
    for at in [*device.project(ENDS), *device.project(ENDS + np.array([0, 60, 0]))][:count]:
        shade[(u - at[0]) ** 2 + (v - at[1]) ** 2 < 7.3**2] = 0.1
    shade = 1.1 - shade if light else shade
    image = 10 + 180 * shade.reshape(height, 4, width, 4).mean(axis=(1, 3))
    image = cv2.GaussianBlur(image, (0, 0), 0.7) + np.random.default_rng(seed).normal(0, 1, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("light", [False, True])
def test_the_ends_are_detected(true_rig: Cameras, light: bool) -> None:
    found = two_circles(balls(true_rig.left, 0, light=light), "p.png")
    truth = true_rig.left.project(ENDS)
    away = np.linalg.norm(found[:, None] - truth[None], axis=2).min(axis=1)
    assert away.max() < 0.05


@pytest.mark.parametrize("count", [0, 1, 3, 4])
def test_images_without_exactly_two_circles_are_rejected(true_rig: Cameras, count: int) -> None:
    with pytest.raises(TargetError, match=rf"p.png: {count} circles of one size stand out, the ends of a bar are two"):
        two_circles(balls(true_rig.left, 0, count=count), "p.png")


def test_the_length_is_measured_and_a_wrong_one_is_reported(
    tmp_path: Path, true_rig: Cameras, truth_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn.write_png(tmp_path / "l.png", balls(true_rig.left, 1))
    drawn.write_png(tmp_path / "r.png", balls(true_rig.right, 2))
    view = ["--left", str(tmp_path / "l.png"), "--right", str(tmp_path / "r.png"), "--calibration", str(truth_file)]
    assert invoke(["calibrate", "check", *view, "--length", str(LENGTH), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert abs(found["mean_mm"]) < 0.03
    assert invoke(["calibrate", "check", *view, "--length", "150.4"]) == 1
    assert "too short" in capsys.readouterr().err
