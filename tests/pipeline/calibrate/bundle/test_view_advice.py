"""Sets of views that determine nothing are refused with what to add; a guided session is told what is missing."""

import numpy as np
import pytest

from pipeline.calibrate.bundle import Options, calibrate
from pipeline.calibrate.bundle.quality.view_assessment import missing
from pipeline.calibrate.bundle.quality.view_coverage import looks
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board
from pipeline.common.errors import CalibrationError
from sim.rig.layout import RigLayout
from tests.pipeline.calibrate.bundle.sessions import poses, rotation, session


def placed(turns, places=None) -> list[tuple]:
    """Boards at the stage with turns (x, y, z in degrees) and places in mm."""
    sr, st = RigLayout().stage_pose()
    middle = DEFAULT_BOARD.points.mean(axis=0)
    places = np.zeros((len(turns), 3)) if places is None else places
    result = []
    for turn, place in zip(turns, places, strict=True):
        r = sr @ rotation(*turn)
        result.append((r, sr @ np.asarray(place) + st - r @ middle))
    return result


RNG = np.random.default_rng(2)
TILTS = [(30, 0, 0), (-30, 0, 0), (0, 30, 0), (0, -30, 0), (25, 25, 5), (-25, 25, -5)]
DEGENERATE = {
    "all alike": placed([(20 + 0.1 * k, 5, 0) for k in range(10)]),
    "never tilted|same tilt": placed(RNG.uniform(-3, 3, (10, 3)), RNG.uniform(-50, 50, (10, 3))),
    "same tilt": placed([(30, 0.0, 0)] * 8, RNG.uniform(-60, 60, (8, 3))),
    "at least 3 are needed": placed(TILTS[:2]),
}


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("why", DEGENERATE)
@pytest.mark.parametrize("devices", [("left",), ("left", "right")])
def test_degenerate_sets_are_refused_with_what_to_add(why, noise, devices):
    views, sizes, _ = session(places=DEGENERATE[why], sigma=noise, devices=devices)
    with pytest.raises(CalibrationError, match=why) as told:
        calibrate(DEFAULT_BOARD, views, sizes)
    assert "tilt" in str(told.value)


def test_a_board_that_covers_a_corner_only_is_refused():
    small = Board("circles", 4, 3, 20.0)
    middle = small.points.mean(axis=0)
    shift = DEFAULT_BOARD.points.mean(axis=0)
    places = [(r, t + r @ (shift - middle)) for r, t in placed([*TILTS] * 2)]
    views, sizes, _ = session(small, places=places, devices=("left",))
    with pytest.raises(CalibrationError, match=r"covers .* of the left image"):
        calibrate(small, views, sizes)


def test_a_set_that_only_just_determines_the_lens_is_refused_by_its_covariance():
    places = placed([(9, 0, 0), (0, 9, 0), (-9, 0, 0), (0, -9, 0)])
    views, sizes, _ = session(places=places, sigma=0.3, devices=("left",))
    with pytest.raises(CalibrationError, match=r"not determine the .* of left: .* deviation .* add: ") as told:
        calibrate(DEFAULT_BOARD, views, sizes)
    assert "limit" in str(told.value)


def test_the_check_can_be_left_to_the_caller():
    views, sizes, _ = session(places=placed(TILTS[:4]), sigma=0.3, devices=("left",))
    solution = calibrate(DEFAULT_BOARD, views, sizes, options=Options(check=False))
    assert solution.sigma["left.cx"] > 3


def test_tilts_are_measured_with_their_signs():
    turns = [(30, 0, 0), (-20, 0, 0), (0, 35, 0), (0, -25, 0), (0, 0, 40), (20, 20, 0)]
    views, sizes, truth = session(places=placed(turns), devices=("left", "right"))
    advice = missing(DEFAULT_BOARD, views, sizes)
    # A turn about x by a positive angle brings the lower edge away; about y by a negative one the right edge.
    assert np.allclose(advice.tilt_x_deg, (-20, 30), atol=1.5)
    assert np.allclose(advice.tilt_y_deg, (-35, 25), atol=1.5)
    seen = looks(DEFAULT_BOARD, views, "left", sizes["left"], model=truth["left"])
    assert abs(seen[4].tilt_deg - 10.3) < 0.5
    assert abs(seen[0].distance_mm / 1400 - 1) < 0.02


def test_a_good_set_lacks_nothing_and_a_growing_one_lacks_ever_less():
    views, sizes, _ = session(sigma=0.03, devices=("left", "right"))
    lacks = [len(missing(DEFAULT_BOARD, views[:n], sizes).missing) for n in range(13)]
    assert lacks[12] == 0 and lacks[0] >= 6 and (np.diff(lacks) <= 0).all()
    done = missing(DEFAULT_BOARD, views, sizes)
    assert done.enough and not done.degenerate and all(share == 1 for share in done.progress.values())


def test_following_the_advice_leads_to_a_calibration():
    """Show the board where the advice says, again and again: nothing is missing in the end."""
    sr, st = RigLayout().stage_pose()
    middle = DEFAULT_BOARD.points.mean(axis=0)
    places: list[tuple] = []
    sizes = session(n=1)[1]
    wishes = []
    for _ in range(12):
        views, _, _ = session(places=places or poses(1, 0, DEFAULT_BOARD, RigLayout(), tilt=1), sigma=0.03)
        views = views if places else []
        pose = missing(DEFAULT_BOARD, views, sizes).next_pose
        wishes.append(pose.text)
        turn = rotation(pose.tilt_x_deg, -pose.tilt_y_deg, 0)
        z = 1400 * (pose.distance - 1)
        place = np.array([(pose.place[0] - 0.5) * 420, (pose.place[1] - 0.5) * 336, z])
        places.append((sr @ turn, sr @ place + st - sr @ turn @ middle))
    views, sizes, truth = session(places=places, sigma=0.03)
    advice = missing(DEFAULT_BOARD, views, sizes)
    assert advice.enough, advice.missing
    assert len(set(wishes)) == 12
    solution = calibrate(DEFAULT_BOARD, views, sizes)
    assert abs(solution.devices["left"].matrix[0, 0] / truth["left"].matrix[0, 0] - 1) < 3e-4
