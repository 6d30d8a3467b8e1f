"""The drawing of a board agrees with its marks, with itself as an image, and with OpenCV's own drawing."""

import cv2
import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, parse_board
from pipeline.calibrate.targets.board.board_drawing import raster, shapes
from pipeline.calibrate.targets.board.charuco_board import charuco
from pipeline.common.errors import TargetError

BOARDS = [
    "circles:11x9:32:20",
    "circles:5x4:7",
    "acircles:4x11:20",
    "chessboard:9x6:25",
    "charuco:6x5:20:14:DICT_4X4_50",
]


@pytest.mark.parametrize("text", BOARDS)
def test_the_area_of_black_is_the_same_in_the_list_and_in_the_image(text):
    board = parse_board(text)
    printed, step = shapes(board), 0.37
    image, origin = raster(board, step)
    squares = printed.squares
    area = (np.pi * printed.discs[:, 2] ** 2).sum()
    area += ((squares[:, 2] - squares[:, 0]) * (squares[:, 3] - squares[:, 1])).sum()
    assert (1 - image.astype(np.float64)).sum() * step**2 == pytest.approx(area, rel=1e-4)
    assert image.min() >= 0 and image.max() == 1
    assert image.shape == (np.ceil(printed.height_mm / step), np.ceil(printed.width_mm / step))
    assert origin == pytest.approx([step / 2 - printed.offset_mm[0], step / 2 - printed.offset_mm[1]])


@pytest.mark.parametrize("text", ["circles:11x9:32:20", "acircles:4x5:20"])
def test_each_mark_is_the_centroid_of_its_black(text):
    board, step = parse_board(text), 0.25
    image, origin = raster(board, step)
    black = 1 - image.astype(np.float64)
    for x, y, _ in board.points:
        r = board.printed_diameter_mm / 2 + 1
        rows = slice(int((y - r - origin[1]) / step), int((y + r - origin[1]) / step) + 2)
        columns = slice(int((x - r - origin[0]) / step), int((x + r - origin[0]) / step) + 2)
        part = black[rows, columns]
        v, u = np.mgrid[rows, columns]
        assert (part * u).sum() / part.sum() * step + origin[0] == pytest.approx(x, abs=3e-4)
        assert (part * v).sum() / part.sum() * step + origin[1] == pytest.approx(y, abs=3e-4)


def test_the_square_at_the_upper_left_of_mark_0_is_black_and_the_colours_alternate_around_each_mark():
    board, step = parse_board("chessboard:5x4:10"), 1.0
    image, origin = raster(board, step)
    for index, (x, y, _) in enumerate(board.points):
        column, row = index % 5, index // 5
        u, v = round((x - origin[0]) / step), round((y - origin[1]) / step)
        upper_left = image[v - 4, u - 4]
        assert upper_left == (column + row) % 2
        assert image[v + 4, u + 4] == upper_left and image[v - 4, u + 4] == 1 - upper_left


def test_a_charuco_board_is_drawn_as_opencv_draws_it():
    board = parse_board("charuco:6x5:24:18:DICT_4X4_50")
    image, _ = raster(board, 1.0, paper_mm=(6 * 24, 5 * 24))
    theirs = charuco(board).generateImage((6 * 24, 5 * 24))
    assert theirs.shape == image.shape
    assert (np.abs(image * 255.0 - theirs) > 1).mean() < 0.002


def test_the_default_board_fits_on_its_sheet_with_the_drawing_in_the_middle():
    printed = shapes(DEFAULT_BOARD, paper_mm=(400, 300))
    assert (printed.width_mm, printed.height_mm) == pytest.approx((400, 300))
    assert printed.offset_mm == pytest.approx((40, 22))
    assert shapes(DEFAULT_BOARD).height_mm <= 300


def test_errors_name_the_remedy():
    with pytest.raises(TargetError, match="take larger paper"):
        shapes(DEFAULT_BOARD, paper_mm=(297, 210))
    with pytest.raises(TargetError, match="larger pixels"):
        raster(DEFAULT_BOARD, 0.001)
    with pytest.raises(TargetError, match="take a larger dictionary"):
        shapes(parse_board("charuco:20x20:10:7:DICT_4X4_50"))
    with pytest.raises(TargetError, match="DICT_4X4_100"):
        shapes(parse_board("charuco:5x5:10:7:no such"))


def test_opencv_reads_the_drawing():
    board = parse_board("charuco:6x5:24:18:DICT_4X4_50")
    image, origin = raster(board, 0.5)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco(board)).detectBoard((image * 255).astype(np.uint8))
    assert sorted(ids.ravel()) == list(range(20))
    positions = corners.reshape(-1, 2) * 0.5 + origin
    assert np.abs(positions - board.points[ids.ravel(), :2]).max() < 0.1
