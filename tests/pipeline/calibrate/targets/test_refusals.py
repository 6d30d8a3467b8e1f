"""Each kind of image that cannot be used has an error of its own, which names the remedy."""

import cv2
import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, parse_board
from pipeline.calibrate.targets.find_marks import find_marks
from pipeline.common.errors import TargetError

from .images import Pose, camera, clean, noisy

DEVICE = camera()
CHESS, CHARUCO = parse_board("chessboard:9x6:34"), parse_board("charuco:10x7:34:24:DICT_4X4_50")
ALL = [DEFAULT_BOARD, parse_board("acircles:5x12:50"), CHESS, CHARUCO]
FAR = Pose(10, 20, 5)


def side_by_side(board):
    """Two of the same board next to each other."""
    one = noisy(clean(board, DEVICE, Pose(10, 20, 5, (0, 0, 2000)), ss=3))
    return np.hstack([one[:, 40:-40], one[:, 40:-40]])


def empty(seed=0):
    rng = np.random.default_rng(seed)
    light = cv2.resize(rng.uniform(40, 200, (6, 8)).astype(np.float32), (512, 410), interpolation=cv2.INTER_CUBIC)
    cv2.rectangle(light, (100, 80), (300, 200), 60.0, -1)
    return noisy(light)


@pytest.mark.parametrize("board", ALL, ids=str)
def test_empty(board):
    even = [noisy(np.full((410, 512), 120.0), seed) for seed in range(2 if board is CHESS else 4)]
    for image in (empty(), np.full((410, 512), 90, np.uint8), *even):
        with pytest.raises(TargetError, match=r"no marks found: the board .* is not in the image"):
            find_marks(image, board)


@pytest.mark.parametrize("board", ALL, ids=str)
def test_too_blurred(board):
    with pytest.raises(TargetError, match=r"too blurred: its edges have a sigma of [\d.]+ px .* focus"):
        find_marks(noisy(clean(board, DEVICE, FAR, blur_px=14, ss=2)), board)


@pytest.mark.parametrize("board", ALL[:2], ids=str)
def test_only_some_marks(board):
    image = noisy(clean(board, DEVICE, FAR, ss=2))
    image[:, :256] = 100
    rng = np.random.default_rng(0)
    image[100:300, 256:400] = rng.integers(80, 120, (200, 144))
    with pytest.raises(TargetError, match=r"only \d+ of the \d+ marks .* whole board"):
        find_marks(image, board)


@pytest.mark.parametrize("board", [ALL[0], CHESS], ids=str)
def test_a_board_that_runs_out_of_the_image_is_not_another_board(board):
    with pytest.raises(TargetError, match=r"only \d+ of the \d+ marks .* whole board"):
        find_marks(noisy(clean(board, DEVICE, Pose(5, 5, 0, (90, 0, 1400)), ss=2)), board)


@pytest.mark.parametrize(
    ("shown", "expected", "detected"),
    [
        pytest.param("circles:11x9:32:20", "circles:10x9:32:20", "11x9", marks=pytest.mark.long),
        pytest.param("circles:10x9:32:20", "circles:11x9:32:20", "10x9", marks=pytest.mark.long),
        ("circles:7x7:40:20", "circles:11x9:32:20", "7x7"),
        ("acircles:5x12:50", "acircles:4x11:50", "5x12"),
        pytest.param("chessboard:8x6:34", "chessboard:9x6:34", "8x6", marks=pytest.mark.long),
        ("chessboard:9x6:34", "chessboard:8x5:34", "9x6"),
        ("charuco:9x7:34:24:DICT_4X4_50", "charuco:10x7:34:24:DICT_4X4_50", "8x6"),
    ],
)
def test_another_size_is_named(shown, expected, detected):
    with pytest.raises(TargetError, match=f"wrong board: the image shows a grid of {detected} marks"):
        find_marks(noisy(clean(parse_board(shown), DEVICE, Pose(10, 20, 5, (0, 0, 1900)), ss=2)), parse_board(expected))


@pytest.mark.parametrize("board", ALL, ids=str)
def test_two_boards(board):
    with pytest.raises(TargetError, match="two boards"):
        find_marks(side_by_side(board), board)


@pytest.mark.parametrize("board", [ALL[1], CHARUCO], ids=str)
def test_mirrored(board):
    image = noisy(clean(board, DEVICE, FAR, ss=2))
    find_marks(image, board)
    for flipped in (image[:, ::-1], image[::-1]):
        with pytest.raises(TargetError, match=r"mirrored .* flip"):
            find_marks(flipped, board)


@pytest.mark.parametrize("board", ALL, ids=str)
def test_saturated(board):
    light = clean(board, DEVICE, FAR, ss=2, dark=0.3)
    with pytest.raises(TargetError, match=r"saturated.* lower the exposure"):
        find_marks(noisy(light, gain=8.0), board)


def test_images_of_the_wrong_kind():
    with pytest.raises(TargetError, match="shape"):
        find_marks(np.zeros((3, 100, 100), np.uint8), DEFAULT_BOARD)
    with pytest.raises(TargetError, match="type int64"):
        find_marks(np.zeros((100, 100), np.int64), DEFAULT_BOARD)
    with pytest.raises(TargetError, match="channel 3"):
        find_marks(np.zeros((100, 100, 3), np.uint8), DEFAULT_BOARD, channel=3)
    with pytest.raises(TargetError, match="not finite"):
        find_marks(np.full((100, 100), np.nan, np.float32), DEFAULT_BOARD)
