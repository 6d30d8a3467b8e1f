"""Chessboards and ChArUco boards of simulated images: positions and numbers of their corners."""

import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import parse_board
from pipeline.calibrate.targets.detect.grid_numbering import symmetries
from pipeline.calibrate.targets.find_marks import find_marks

from .images import Pose, camera, clean, noisy, truth

DEVICE = camera()
FAR = (0.0, 0.0, 1800.0)
CHESS, CHARUCO = parse_board("chessboard:9x6:34"), parse_board("charuco:10x7:34:24:DICT_4X4_50")


def errors(found, board, pose):
    """Detected minus true positions, in the board's own numbering by colours or markers."""
    return found.marks.pixels - truth(board, DEVICE, pose)[found.marks.ids]


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=str)
@pytest.mark.parametrize(
    "pose",
    [
        Pose(40, 10),
        Pose(-20, 40, 30, FAR),
        Pose(15, -15, 180),
        pytest.param(Pose(), marks=pytest.mark.long),
        pytest.param(Pose(10, 10, 90, FAR), marks=pytest.mark.long),
    ],
)
def test_every_corner_is_located_where_the_full_model_has_it(board, pose):
    light = clean(board, DEVICE, pose, shade=(0.6, -0.4))
    error, sigma = [], []
    for seed in range(3):
        found = find_marks(noisy(light, seed), board)
        assert list(found.marks.ids) == list(range(len(board.points)))
        assert found.marks.areas_px is None
        error.append(errors(found, board, pose))
        sigma.append(found.marks.sigma_px)
    error, sigma = np.array(error), np.array(sigma)
    assert np.sqrt((error**2).mean()) < 0.02
    assert np.sqrt((error**2).mean() / (sigma**2).mean()) == pytest.approx(1, abs=0.3)
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.003


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=str)
def test_moving_the_image_and_its_gain_change_nothing(board):
    pose = Pose(20, -25, 8)
    image = noisy(clean(board, DEVICE, pose, ss=2))
    marks = find_marks(image, board).marks
    moved = find_marks(np.pad(image, ((3, 0), (8, 0)), mode="edge"), board).marks
    assert (moved.ids == marks.ids).all()
    assert np.abs(moved.pixels - marks.pixels - (8, 3)).max() < 0.01
    scaled = find_marks(image.astype(np.float32) * 0.01 - 0.3, board).marks
    assert np.abs(scaled.pixels - marks.pixels).max() < 0.02


def test_a_symmetric_board_has_rows_that_run_right_or_down():
    for text, ways in (("chessboard:7x5:34", 2), ("chessboard:6x6:34", 4), ("chessboard:8x5:34", 1)):
        board = parse_board(text)
        assert len(symmetries(board)) == ways
        for turn in range(0, 360, 60):
            pose = Pose(10, 10, turn + 5)
            found = find_marks(noisy(clean(board, DEVICE, pose, ss=2)), board, refine=False)
            expected = truth(board, DEVICE, pose)
            trials = [
                np.abs(found.marks.pixels - expected[np.array(s)][found.marks.ids]).max() for s in symmetries(board)
            ]
            assert min(trials) < 0.5
            basis = np.column_stack([board.points[found.marks.ids, :2], np.ones(len(found.marks))])
            right = np.linalg.lstsq(basis, found.marks.pixels, rcond=None)[0][0]
            assert ways != 2 or right.sum() > 0
            assert ways != 4 or right[0] > 0.7 * np.linalg.norm(right)


def test_a_part_of_a_charuco_board_is_enough():
    pose = Pose(20, -25, 8)
    image = noisy(clean(CHARUCO, DEVICE, pose))
    image[:, 230:] = 90
    found = find_marks(image, CHARUCO)
    assert 6 <= len(found.marks) < 40
    assert np.abs(errors(found, CHARUCO, pose)).max() < 0.1


def test_corners_are_located_although_their_markers_cannot_be_decoded():
    """The markers of the middle are painted over; the corners of their squares are not."""
    pose = Pose(20, -25, 8)
    image = noisy(clean(CHARUCO, DEVICE, pose))
    whole = find_marks(image, CHARUCO).marks
    rotation, translation = pose.of(CHARUCO)
    for row in range(1, 6):
        for column in range(1, 9):
            if (row + column) % 2:
                at = np.array([[column - 0.5, row - 0.5, 0]]) * CHARUCO.pitch_mm @ rotation.T + translation
                u, v = np.round(DEVICE.project(at)[0]).astype(int)
                image[v - 10 : v + 11, u - 9 : u + 10] = 150
    found = find_marks(image, CHARUCO)
    assert list(found.marks.ids) == list(whole.ids) == list(range(54))
    assert np.abs(errors(found, CHARUCO, pose)).max() < 0.1


def test_the_drawing_of_older_opencv_versions_is_read():
    import cv2

    from pipeline.calibrate.targets.board.charuco_board import charuco

    board = parse_board("charuco:7x6:30:20:DICT_5X5_50")
    drawing = charuco(board, legacy=True).generateImage((7 * 40, 6 * 40))
    image = cv2.GaussianBlur(cv2.copyMakeBorder(drawing, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255), (0, 0), 0.8)
    found = find_marks(image, board)
    assert len(found.marks) == 30
    assert np.abs(found.marks.pixels - (board.points[:, :2] / 30 * 40 + 79.5)).max() < 0.05


def test_unrefined_detection():
    for board in (CHESS, CHARUCO):
        image = noisy(clean(board, DEVICE, Pose(20, -25, 8)))
        quick, best = find_marks(image, board, refine=False), find_marks(image, board)
        assert (quick.marks.ids == best.marks.ids).all()
        assert np.abs(quick.marks.pixels - best.marks.pixels).max() < 0.5
        assert best.sharpness_px == pytest.approx(0.76, rel=0.1) and best.contrast > 0.9
