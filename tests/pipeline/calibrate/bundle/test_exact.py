"""Exact marks give the exact rig, in any order, for short and long lenses and any part of the rig."""

import numpy as np
import pytest

from pipeline.calibrate.bundle import Options, calibrate
from pipeline.calibrate.bundle.adjust.state import intrinsics_of
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board, parse_board
from pipeline.calibrate.targets.localise import circle_projection
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.common.errors import CalibrationError
from sim.rig.layout import RigLayout
from tests.pipeline.calibrate.bundle.sessions import poses, session


def agree(solution, truth, *, intrinsic: float = 1e-6, pose: float = 1e-6) -> None:
    for name, model in solution.devices.items():
        expected = intrinsics_of(truth[name])
        deviation = np.abs(intrinsics_of(model) - expected)
        # k3 of a long lens is the r^6 term of an image that ends at r = 0.2.
        assert (deviation[:5] < intrinsic).all() and (deviation[5:9] < intrinsic).all() and deviation[9] < 1e-4, (
            name,
            deviation,
        )
        assert np.abs(model.rotation - truth[name].rotation).max() < pose
        assert np.abs(model.translation - truth[name].translation).max() < 1e3 * pose


@pytest.mark.parametrize(
    "devices", [("left", "right", "projector"), ("left", "right"), ("left",), ("left", "projector"), ("right",)]
)
def test_exact_marks_give_the_exact_rig(devices):
    views, sizes, truth = session(devices=devices)
    if devices == ("right",):
        solution = calibrate(DEFAULT_BOARD, views, sizes)
        assert np.abs(intrinsics_of(solution.devices["right"])[:9] - intrinsics_of(truth["right"])[:9]).max() < 1e-6
        return
    solution = calibrate(DEFAULT_BOARD, views, sizes)
    agree(solution, truth)
    assert solution.views_used == 12 and solution.views_rejected == 0 and not solution.rejected
    assert max(solution.rms.values()) < 1e-8
    if "right" in devices:
        assert abs(solution.baseline_mm - 500) < 1e-6
        assert solution.epipolar_px < 1e-8


@pytest.mark.parametrize(
    ("focal", "standoff"), [(700.0, 500.0), pytest.param(1500.0, 900.0, marks=pytest.mark.long), (8000.0, 3000.0)]
)
def test_short_and_long_lenses_need_no_help(focal, standoff):
    layout = RigLayout(focal_px=focal, standoff_mm=standoff, projector_focal_px=1.25 * focal, baseline_mm=standoff / 3)
    views, sizes, truth = session(layout=layout)
    agree(calibrate(DEFAULT_BOARD, views, sizes), truth, intrinsic=1e-5)


@pytest.mark.parametrize(
    "text",
    ["acircles:7x15:32", pytest.param("chessboard:9x7:32", marks=pytest.mark.long), "charuco:11x9:32:22:DICT_4X4_100"],
)
def test_every_kind_of_board_will_do(text):
    board = parse_board(text)
    views, sizes, truth = session(board)
    agree(calibrate(board, views, sizes), truth)


def test_the_order_of_views_and_marks_does_not_matter():
    views, sizes, _ = session(sigma=0.03)
    rng = np.random.default_rng(5)

    def shuffled(marks: Marks) -> Marks:
        order = rng.permutation(len(marks))
        return Marks(marks.ids[order], marks.pixels[order], marks.sigma_px[order])

    mixed = [BoardView(v.name, {d: shuffled(m) for d, m in v.marks.items()}) for v in rng.permutation(np.array(views))]
    one, other = calibrate(DEFAULT_BOARD, views, sizes), calibrate(DEFAULT_BOARD, mixed, sizes)
    for name in one.values:
        assert abs(one.values[name] - other.values[name]) < 1e-4 * max(one.sigma[name], 1e-9), name
        assert abs(one.sigma[name] - other.sigma[name]) <= 1e-3 * one.sigma[name], name


def test_a_known_rig_as_start_leads_to_the_same_end():
    views, sizes, truth = session(sigma=0.03)
    free = calibrate(DEFAULT_BOARD, views, sizes)
    helped = calibrate(DEFAULT_BOARD, views, sizes, start=truth)
    for name, value in free.values.items():
        assert abs(value - helped.values[name]) < 1e-3 * max(free.sigma[name], 1e-9), name


@pytest.mark.parametrize("diameter_mm", [pytest.param(20.0, marks=pytest.mark.long), 0.0])
def test_centroids_of_circles_are_predicted_as_centroids(diameter_mm):
    """With the offset of each circle predicted the rig is exact; the circles' diameter comes from their areas."""
    views, sizes, truth = session(devices=("left", "right"))
    round_views = []
    board_poses = poses(12, 0, DEFAULT_BOARD, RigLayout())
    for view, (r, t) in zip(views, board_poses, strict=True):
        marks = {}
        for name, centres in view.marks.items():
            model = truth[name]
            pose = (model.rotation @ r, model.rotation @ t + model.translation, DEFAULT_BOARD.points[centres.ids], 10.0)
            marks[name] = Marks(
                centres.ids,
                circle_projection.centroids(model, *pose),
                centres.sigma_px,
                circle_projection.areas(model, *pose),
            )
        round_views.append(BoardView(view.name, marks))
    board = Board("circles", 11, 9, 32.0, diameter_mm)
    solution = calibrate(board, round_views, sizes)
    agree(solution, truth, intrinsic=1e-4, pose=1e-7)
    assert abs(solution.diameter_mm - 20) < 1e-5
    assert solution.offsets_px > 0.05
    with pytest.raises(CalibrationError, match=r"circles measure 20\.0 mm if their pitch is 32 mm"):
        calibrate(Board("circles", 11, 9, 32.0, 14.0), round_views, sizes)
    ignored = [
        BoardView(v.name, {d: Marks(m.ids, m.pixels, m.sigma_px) for d, m in v.marks.items()}) for v in round_views
    ]
    wrong = calibrate(board, ignored, sizes)
    assert abs(wrong.devices["left"].matrix[0, 0] - truth["left"].matrix[0, 0]) > 0.1


def test_held_parameters_stay():
    views, sizes, truth = session(sigma=0.02)
    options = Options(skew=False, k3=False, tangential=False)
    solution = calibrate(DEFAULT_BOARD, views, sizes, options=options)
    for name in sizes:
        assert solution.devices[name].matrix[0, 1] == 0 and (solution.devices[name].distortion[2:] == 0).all()
        assert solution.sigma[f"{name}.skew"] == solution.sigma[f"{name}.k3"] == solution.sigma[f"{name}.p1"] == 0
    aspect = calibrate(DEFAULT_BOARD, views, sizes, options=Options(aspect=1.0003)).devices["left"].matrix
    assert abs(aspect[1, 1] / aspect[0, 0] - 1.0003) < 1e-12
    held = calibrate(DEFAULT_BOARD, views, sizes, options=Options(fixed=("left", "right.k3")), start=truth)
    assert np.array_equal(intrinsics_of(held.devices["left"]), intrinsics_of(truth["left"]))
    assert held.devices["right"].distortion[4] == 0 != held.devices["right"].distortion[1]
