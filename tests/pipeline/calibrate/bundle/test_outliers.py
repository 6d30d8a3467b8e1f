"""Marks and views that do not fit are rejected by name, and the result is as good as without them."""

import numpy as np
import pytest

from pipeline.calibrate.bundle import Options, calibrate
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.common.errors import CalibrationError
from tests.pipeline.calibrate.bundle.sessions import session


def moved(view: BoardView, device: str, ids, by) -> BoardView:
    """The same view with some marks of one device displaced."""
    old = view.marks[device]
    pixels = old.pixels.copy()
    pixels[np.isin(old.ids, ids)] += by
    return BoardView(view.name, view.marks | {device: Marks(old.ids, pixels, old.sigma_px, old.areas_px)})


def close(one, other, *, sigmas: float = 1.0) -> None:
    for name, value in one.values.items():
        assert abs(value - other.values[name]) <= sigmas * max(other.sigma[name], 1e-12), name


@pytest.fixture(scope="module")
def clean():
    views, sizes, truth = session(sigma=0.03)
    return views, sizes, truth, calibrate(DEFAULT_BOARD, views, sizes)


def test_clean_marks_are_all_used(clean):
    assert clean[3].rejected == ()


@pytest.mark.parametrize("far", [0.4, *(pytest.param(far, marks=pytest.mark.long) for far in (5.0, 300.0))])
def test_single_wrong_marks_are_rejected_by_number(clean, far):
    views, sizes, _, without = clean
    wrong = list(views)
    planted = {(2, "left"): [17, 40], (2, "right"): [50], (7, "projector"): [3], (9, "left"): [60, 61, 62, 63]}
    for (view, device), ids in planted.items():
        wrong[view] = moved(wrong[view], device, ids, (far, -0.7 * far))
    solution = calibrate(DEFAULT_BOARD, wrong, sizes)
    assert {(r.view, r.device): list(r.ids) for r in solution.rejected} == {
        (f"view_{view:02d}", device): ids for (view, device), ids in planted.items()
    }
    assert all("standard deviations" in r.reason for r in solution.rejected)
    assert solution.views_used == 12 and solution.views_rejected == 0
    close(solution, without)


def test_a_board_that_moved_between_the_images_is_rejected_with_the_reason(clean):
    views, sizes, _, without = clean
    other = session(sigma=0.03, pose_seed=9)[0][4]
    wrong = list(views)
    wrong[4] = BoardView("view_04", wrong[4].marks | {"right": other.marks["right"]})
    solution = calibrate(DEFAULT_BOARD, wrong, sizes)
    assert [(r.view, r.device, r.ids) for r in solution.rejected] == [("view_04", "right", ())]
    assert "moved" in solution.rejected[0].reason
    close(solution, without, sigmas=2)
    pairs = [BoardView(v.name, {d: v.marks[d] for d in ("left", "right")}) for v in wrong]
    two = calibrate(DEFAULT_BOARD, pairs, {d: sizes[d] for d in ("left", "right")})
    assert [(r.view, r.device, r.ids) for r in two.rejected] == [("view_04", "", ())]
    assert two.views_rejected == 1 and two.poses[4] is None


@pytest.mark.parametrize("by_px", [1.0, pytest.param(4.0, marks=pytest.mark.long)])
def test_a_slightly_displaced_image_is_rejected(clean, by_px):
    """A board moved by half a millimetre between left and right: each image alone is exact."""
    views, sizes, _, without = clean
    wrong = list(views)
    wrong[6] = moved(wrong[6], "right", np.arange(99), (0.6 * by_px, by_px))
    solution = calibrate(DEFAULT_BOARD, wrong, sizes)
    assert {r.view for r in solution.rejected} == {"view_06"}
    close(solution, without, sigmas=2)


def test_a_projector_image_that_does_not_fit_is_rejected_alone(clean):
    views, sizes, _, _ = clean
    wrong = list(views)
    wrong[6] = moved(wrong[6], "projector", np.arange(99), (40.0, 3.0))
    solution = calibrate(DEFAULT_BOARD, wrong, sizes)
    assert [(r.view, r.device) for r in solution.rejected] == [("view_06", "projector")]
    assert solution.views_used == 12 and ("view_06", "left") in solution.residuals


def test_an_image_with_few_marks_and_an_empty_view_are_named(clean):
    views, sizes, _, _ = clean
    few = views[3].marks["right"]
    wrong = [*views, BoardView("empty", {})]
    row = views[8].marks["left"]
    wrong[8] = BoardView("view_08", views[8].marks | {"left": row.some(row.ids // 11 == 4)})
    wrong[3] = BoardView("view_03", views[3].marks | {"right": few.some(np.arange(len(few)) < 5)})
    solution = calibrate(DEFAULT_BOARD, wrong, sizes)
    assert {(r.view, r.device) for r in solution.rejected} == {
        ("view_03", "right"),
        ("view_08", "left"),
        ("empty", ""),
    }
    assert "lie on one line" in {r.view: r.reason for r in solution.rejected}["view_08"]
    assert solution.views_used == 12 and solution.views_rejected == 1 and solution.poses[12] is None


def test_two_views_of_one_name_are_refused(clean):
    views, sizes, _, _ = clean
    with pytest.raises(CalibrationError, match="view_03 occurs twice"):
        calibrate(DEFAULT_BOARD, [*views, views[3]], sizes)


def test_more_bad_views_than_the_limit_is_an_error(clean):
    views, sizes, _, _ = clean
    other = session(sigma=0.03, pose_seed=9)[0]
    wrong = [BoardView(v.name, v.marks | {"right": o.marks["right"]}) for v, o in zip(views, other, strict=True)]
    with pytest.raises(CalibrationError, match="belong together"):
        calibrate(DEFAULT_BOARD, wrong, sizes)
    five = [*wrong[:5], *views[5:]]
    with pytest.raises(CalibrationError, match="5 of 12 views do not fit"):
        calibrate(DEFAULT_BOARD, five, sizes)


def test_too_many_bad_marks_is_an_error(clean):
    views, sizes, _, _ = clean
    rng = np.random.default_rng(1)
    wrong = [
        BoardView(
            v.name,
            {
                d: Marks(m.ids, m.pixels + (rng.random((len(m), 1)) < 0.2) * rng.normal(0, 3, (len(m), 2)), m.sigma_px)
                for d, m in v.marks.items()
            },
        )
        for v in views
    ]
    with pytest.raises(CalibrationError, match="% of the marks do not fit"):
        calibrate(DEFAULT_BOARD, wrong, sizes)


def test_the_other_robust_loss_agrees(clean):
    views, sizes, _, without = clean
    wrong = list(views)
    wrong[2] = moved(wrong[2], "left", [17], (3.0, 0.0))
    close(calibrate(DEFAULT_BOARD, wrong, sizes, options=Options(loss="cauchy")), without, sigmas=1)
