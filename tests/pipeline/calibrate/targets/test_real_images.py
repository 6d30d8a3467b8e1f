"""Public images: every board is detected, and the results agree with the known values."""

import cv2
import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import Board, parse_board
from pipeline.calibrate.targets.detect.grid_numbering import symmetries
from pipeline.calibrate.targets.find_marks import find_marks

pytestmark = pytest.mark.shared


def stored(path):
    """Expected centres, (rows, columns, 2)."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        return file.getNode("corners").mat().reshape(-1, file.getNode("corners").mat().shape[1], 2)
    finally:
        file.release()


@pytest.mark.parametrize("refine", [True, False])
@pytest.mark.parametrize(
    ("folder", "name", "kind", "count"),
    [("symmetric", "circles", "circles", 14), ("asymmetric", "acircles", "acircles", 9)],
)
def test_all_circle_boards_are_detected_near_the_stored_centres(shared_data, folder, name, kind, count, refine):
    """The stored centres are centroids of blobs, which differ from the edges' ellipses by some tenths of a pixel.

    Thresholds alone do worse than a fit where the camera has sharpened the image (circles2).
    """
    for number in range(1, count + 1):
        image = cv2.imread(str(shared_data("circles", folder, f"{name}{number}.png")), cv2.IMREAD_GRAYSCALE)
        expected = stored(shared_data("circles", folder, f"{name}_corners{number}.dat"))
        board = Board(kind, expected.shape[1], expected.shape[0], 10.0)
        marks = find_marks(image, board, refine=refine).marks
        assert len(marks) == expected.size // 2, f"{name}{number}"
        trials = [
            np.linalg.norm(marks.pixels - expected.reshape(-1, 2)[np.array(s)][marks.ids], axis=1)
            for s in symmetries(board)
        ]
        distance = min(trials, key=np.max)
        assert np.median(distance) < 0.2 and distance.max() < (0.5 if refine else 0.8), f"{name}{number}"


@pytest.mark.long
def test_all_chessboards_are_detected_and_calibrate_better_than_opencv_corners(shared_data):
    """OpenCV's detector with cornerSubPix gives 0.198, 0.210 and 0.219 px on these images (see their README)."""
    board = parse_board("chessboard:9x6:1")
    pixels = {"left": [], "right": []}
    for side, found in pixels.items():
        for number in range(1, 15):
            image = cv2.imread(str(shared_data("chessboard_stereo", f"{side}{number:02}.jpg")), cv2.IMREAD_GRAYSCALE)
            marks = find_marks(image, board).marks
            assert len(marks) == 54
            found.append(marks.pixels.astype(np.float32))
    at = [board.points.astype(np.float32)] * 14
    left, right = (cv2.calibrateCamera(at, found, (640, 480), None, None)[:3] for found in pixels.values())
    stereo = cv2.stereoCalibrate(
        at, pixels["left"], pixels["right"], *left[1:], *right[1:], (640, 480), flags=cv2.CALIB_FIX_INTRINSIC
    )
    assert left[0] < 0.17 and right[0] < 0.17 and stereo[0] < 0.185
    assert np.linalg.norm(stereo[6]) == pytest.approx(3.33, abs=0.02)
