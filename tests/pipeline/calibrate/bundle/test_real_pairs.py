"""Real stereo pairs: at least as good as OpenCV's own pipeline on the same corners."""

import cv2
import numpy as np
import pytest

from pipeline.calibrate.bundle import Options, calibrate
from pipeline.calibrate.bundle.quality.reprojection_error import epipolar_distances
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.rig.camera_model import CameraModel

pytestmark = pytest.mark.shared

BOARD = Board("chessboard", 9, 6, 1.0)
SIZE = (640, 480)


@pytest.fixture(scope="module")
def corners(shared_data):
    """By side, (14, 54, 2) pixels."""
    found = {}
    for side in ("left", "right"):
        rows = []
        for k in range(1, 15):
            image = cv2.imread(str(shared_data("chessboard_stereo", f"{side}{k:02d}.jpg")), cv2.IMREAD_GRAYSCALE)
            ok, rough = cv2.findChessboardCorners(image, (9, 6))
            assert ok
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.01)
            rows.append(cv2.cornerSubPix(image, rough, (5, 5), (-1, -1), stop).reshape(-1, 2))
        found[side] = np.array(rows)
    return found


@pytest.fixture(scope="module")
def opencv(corners):
    """OpenCV's devices, rms by side and stereo rms."""
    points = [BOARD.points.astype(np.float32)] * 14
    seen = {side: [view[:, None].astype(np.float32) for view in corners[side]] for side in corners}
    alone = {side: cv2.calibrateCamera(points, seen[side], SIZE, None, None) for side in seen}
    (_, k1, d1), (_, k2, d2) = (alone[side][:3] for side in ("left", "right"))
    both = cv2.stereoCalibrate(points, seen["left"], seen["right"], k1, d1, k2, d2, SIZE, flags=cv2.CALIB_FIX_INTRINSIC)
    left = CameraModel(SIZE, k1, d1.ravel()[:5], name="left")
    right = CameraModel(SIZE, k2, d2.ravel()[:5], both[5], both[6].ravel(), name="right")
    return left, right, {side: alone[side][0] for side in alone}, both[0]


def views(corners, sides=("left", "right")):
    return [
        BoardView(
            f"{k + 1:02d}",
            {s: Marks(np.arange(54), corners[s][k].astype(np.float64), np.full(54, 0.1)) for s in sides},
        )
        for k in range(14)
    ]


def epipolar(left, right, corners) -> float:
    a, b = (corners[side].reshape(-1, 2).astype(np.float64) for side in ("left", "right"))
    return float(epipolar_distances(left, right, a, b).mean())


@pytest.mark.parametrize("skew", [False, True])
def test_the_joint_adjustment_is_at_least_as_good_as_opencv(corners, opencv, skew):
    left, right, alone, stereo = opencv
    solution = calibrate(BOARD, views(corners), {"left": SIZE, "right": SIZE}, options=Options(skew=skew))
    assert alone["left"] == pytest.approx(0.198, abs=0.002) and stereo == pytest.approx(0.219, abs=0.002)
    assert solution.views_used == 14 and solution.rejected == ()
    assert solution.rms_stereo <= stereo
    theirs = epipolar(left, right, corners)
    assert theirs == pytest.approx(0.134, abs=0.002)
    assert epipolar(solution.devices["left"], solution.devices["right"], corners) <= theirs
    assert solution.epipolar_px <= theirs
    for name, model in (("left", left), ("right", right)):
        for key, at in (("fx", (0, 0)), ("cx", (0, 2)), ("cy", (1, 2))):
            away = solution.values[f"{name}.{key}"] - model.matrix[at]
            assert abs(away) < 4 * solution.sigma[f"{name}.{key}"], (name, key, away)
    assert abs(solution.baseline_mm - 3.33) < 0.01


@pytest.mark.parametrize("side", ["left", "right"])
def test_one_camera_alone_is_at_least_as_good_as_opencv(corners, opencv, side):
    solution = calibrate(BOARD, views(corners, (side,)), {side: SIZE}, options=Options(loss="squared"))
    assert solution.rms[side] <= opencv[2][side] + 1e-6
    same = calibrate(BOARD, views(corners, (side,)), {side: SIZE}, options=Options(loss="squared", skew=False))
    assert same.rms[side] == pytest.approx(opencv[2][side], abs=2e-4)
    theirs = opencv[0 if side == "left" else 1]
    assert np.abs(same.devices[side].matrix - theirs.matrix).max() < 0.2
