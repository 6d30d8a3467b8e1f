"""Capture folders hold the images of their description, and the truth."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import parse_board
from pipeline.pattern import sequence
from pipeline.rig import calibration
from sim.boards import board_scene, session
from sim.rig.layout import RigLayout

SMALL = ["--scale", "0.0625", "--views", "2", "--board", "circles:5x4:60:36"]


def test_a_session_for_the_projector_is_a_capture_folder_with_its_truth(tmp_path):
    folder = tmp_path / "session"
    assert session.main([str(folder), *SMALL, "--projector", "--seed", "3", "noise=0.5"]) == 0
    description = json.loads((folder / "capture.json").read_text())
    frames = sequence.from_mapping(description["sequence"])
    assert description["encoding"] == "rgb8"
    assert frames.name == "projector"
    layout = RigLayout().scaled(0.0625)
    for view in range(2):
        for k in range(len(frames)):
            for side in ("left", "right"):
                image = cv2.imread(str(folder / f"view_{view:02d}" / f"{side}_{k:02d}.png"), cv2.IMREAD_UNCHANGED)
                assert image.shape == (*layout.camera_size[::-1], 3)
        assert not (folder / f"view_{view:02d}" / f"left_{len(frames):02d}.png").exists()
    true = calibration.from_mapping(json.loads((folder / "truth_calibration.json").read_text()))
    assert true.right.translation == pytest.approx(layout.calibration().right.translation)
    views = json.loads((folder / "truth.json").read_text())["views"]
    board, pose = (
        parse_board("circles:5x4:60:36"),
        board_scene.session_poses(2, 3, layout, parse_board("circles:5x4:60:36")),
    )
    marks = board_scene.true_marks(layout, board, pose[1])
    for name, pixels in views[1]["points"].items():
        assert np.array(pixels) == pytest.approx(marks[name])
    assert np.abs(np.array(views[1]["centroids"]["left"]) - marks["left"]).max() < 0.5


def test_plain_images_are_paired_by_their_numbers(tmp_path):
    assert session.main([str(tmp_path), *SMALL, "--plain", "--encoding", "mono16"]) == 0
    assert sorted(path.name for path in tmp_path.glob("*.png")) == [
        "left_00.png", "left_01.png", "right_00.png", "right_01.png",
    ]  # fmt: skip
    image = cv2.imread(str(tmp_path / "left_01.png"), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16
    assert 20_000 < image.max() < 65_535


def test_a_session_for_the_colours_is_one_view_of_a_white_board(tmp_path):
    assert session.main([str(tmp_path), "--scale", "0.0625", "--color"]) == 0
    frames = sequence.from_mapping(json.loads((tmp_path / "capture.json").read_text())["sequence"])
    assert frames.name == "color"
    assert [path.name for path in tmp_path.glob("view_*")] == ["view_00"]
    assert len(list((tmp_path / "view_00").glob("left_*.png"))) == len(frames)
    white = cv2.imread(str(tmp_path / "view_00" / "left_01.png"))
    assert np.median(white) > 100
    assert white.max() < 255


def test_white_images_are_as_bright_as_they_may_be(tmp_path):
    assert session.main([str(tmp_path), *SMALL, "gamma=1.0"]) == 0
    image = cv2.imread(str(tmp_path / "view_00" / "left_00.png"))
    assert 120 < image.max() < 255


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--board", "hexagons:3x3:1"], "unknown kind"),
        (["gama=2"], "gama"),
        (["gamma"], "key=value"),
        (["--views", "0"], "session_poses"),
    ],
)
def test_wrong_arguments_give_a_one_line_message(arguments, message, tmp_path, capsys):
    folder = tmp_path / "nothing"
    assert session.main([str(folder), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not folder.exists()
