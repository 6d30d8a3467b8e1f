"""Degenerate sets of views are refused with what to add; the assessment lists the missing views."""

import numpy as np
import pytest

from pipeline.calibrate.bundle import Options, calibrate
from pipeline.calibrate.bundle.quality.view_assessment import assess_views
from pipeline.calibrate.bundle.quality.view_coverage import view_geometries
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board
from pipeline.common.errors import CalibrationError
from sim.rig.layout import RigLayout
from tests.pipeline.calibrate.bundle.sessions import poses, rotation, session


def board_poses_of(turns, board_poses=None) -> list[tuple]:
    """Board poses at the stage with rotations (x, y, z in degrees) and positions in mm."""
    sr, st = RigLayout().stage_pose()
    middle = DEFAULT_BOARD.points.mean(axis=0)
    board_poses = np.zeros((len(turns), 3)) if board_poses is None else board_poses
    result = []
    for turn, place in zip(turns, board_poses, strict=True):
        r = sr @ rotation(*turn)
        result.append((r, sr @ np.asarray(place) + st - r @ middle))
    return result


RNG = np.random.default_rng(2)
TILTS = [(30, 0, 0), (-30, 0, 0), (0, 30, 0), (0, -30, 0), (25, 25, 5), (-25, 25, -5)]
DEGENERATE = {
    "all alike": board_poses_of([(20 + 0.1 * k, 5, 0) for k in range(10)]),
    "never tilted|same tilt": board_poses_of(RNG.uniform(-3, 3, (10, 3)), RNG.uniform(-50, 50, (10, 3))),
    "same tilt": board_poses_of([(30, 0.0, 0)] * 8, RNG.uniform(-60, 60, (8, 3))),
    "at least 3 are needed": board_poses_of(TILTS[:2]),
}


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("reason", DEGENERATE)
@pytest.mark.parametrize("devices", [("left",), ("left", "right")])
def test_degenerate_sets_are_refused_with_what_to_add(reason, noise, devices):
    views, sizes, _ = session(board_poses=DEGENERATE[reason], sigma=noise, devices=devices)
    with pytest.raises(CalibrationError, match=reason) as error:
        calibrate(DEFAULT_BOARD, views, sizes)
    assert "tilt" in str(error.value)


def test_a_board_that_covers_a_corner_only_is_refused():
    small = Board("circles", 4, 3, 20.0)
    middle = small.points.mean(axis=0)
    shift = DEFAULT_BOARD.points.mean(axis=0)
    board_poses = [(r, t + r @ (shift - middle)) for r, t in board_poses_of([*TILTS] * 2)]
    views, sizes, _ = session(small, board_poses=board_poses, devices=("left",))
    with pytest.raises(CalibrationError, match=r"covers .* of the left image"):
        calibrate(small, views, sizes)


def test_a_set_that_only_just_determines_the_lens_is_refused_by_its_covariance():
    board_poses = board_poses_of([(9, 0, 0), (0, 9, 0), (-9, 0, 0), (0, -9, 0)])
    views, sizes, _ = session(board_poses=board_poses, sigma=0.3, devices=("left",))
    with pytest.raises(CalibrationError, match=r"not determine the .* of left: .* deviation .* add: ") as error:
        calibrate(DEFAULT_BOARD, views, sizes)
    assert "limit" in str(error.value)


def test_the_check_can_be_left_to_the_caller():
    views, sizes, _ = session(board_poses=board_poses_of(TILTS[:4]), sigma=0.3, devices=("left",))
    solution = calibrate(DEFAULT_BOARD, views, sizes, options=Options(check=False))
    assert solution.sigma["left.cx"] > 3


def test_tilts_are_measured_with_their_signs():
    turns = [(30, 0, 0), (-20, 0, 0), (0, 35, 0), (0, -25, 0), (0, 0, 40), (20, 20, 0)]
    views, sizes, truth = session(board_poses=board_poses_of(turns), devices=("left", "right"))
    assessment = assess_views(DEFAULT_BOARD, views, sizes)
    # A positive rotation about x moves the lower edge away; a negative one about y the right edge.
    assert np.allclose(assessment.tilt_x_deg, (-20, 30), atol=1.5)
    assert np.allclose(assessment.tilt_y_deg, (-35, 25), atol=1.5)
    geometries = view_geometries(DEFAULT_BOARD, views, "left", sizes["left"], model=truth["left"])
    assert abs(geometries[4].tilt_deg - 10.3) < 0.5
    assert abs(geometries[0].distance_mm / 1400 - 1) < 0.02


def test_a_complete_set_lacks_nothing_and_a_growing_one_lacks_less():
    views, sizes, _ = session(sigma=0.03, devices=("left", "right"))
    lacks = [len(assess_views(DEFAULT_BOARD, views[:n], sizes).missing) for n in range(13)]
    assert lacks[12] == 0 and lacks[0] >= 6 and (np.diff(lacks) <= 0).all()
    complete = assess_views(DEFAULT_BOARD, views, sizes)
    assert complete.enough and not complete.degenerate and all(share == 1 for share in complete.progress.values())


def test_showing_the_proposed_poses_gives_a_calibration():
    """Views in the proposed poses, one after the other, end with nothing missing."""
    sr, st = RigLayout().stage_pose()
    middle = DEFAULT_BOARD.points.mean(axis=0)
    board_poses: list[tuple] = []
    sizes = session(n=1)[1]
    proposed = []
    for _ in range(12):
        views, _, _ = session(board_poses=board_poses or poses(1, 0, DEFAULT_BOARD, RigLayout(), tilt=1), sigma=0.03)
        views = views if board_poses else []
        pose = assess_views(DEFAULT_BOARD, views, sizes).next_pose
        proposed.append(pose.text)
        turn = rotation(pose.tilt_x_deg, -pose.tilt_y_deg, 0)
        z = 1400 * (pose.distance - 1)
        place = np.array([(pose.position[0] - 0.5) * 420, (pose.position[1] - 0.5) * 336, z])
        board_poses.append((sr @ turn, sr @ place + st - sr @ turn @ middle))
    views, sizes, truth = session(board_poses=board_poses, sigma=0.03)
    assessment = assess_views(DEFAULT_BOARD, views, sizes)
    assert assessment.enough, assessment.missing
    assert len(set(proposed)) == 12
    solution = calibrate(DEFAULT_BOARD, views, sizes)
    assert abs(solution.devices["left"].matrix[0, 0] / truth["left"].matrix[0, 0] - 1) < 3e-4
