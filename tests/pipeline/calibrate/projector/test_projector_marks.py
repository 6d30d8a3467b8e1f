"""Marks on the projector's image: exact without noise, within their sigma with it, and errors that name the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibrate.projector.absolute_phase import Coordinate
from pipeline.calibrate.projector.projector_marks import CameraObservation, marks_by_camera, projector_marks
from pipeline.calibrate.targets.board.board import Board
from pipeline.common.errors import TargetError
from sim.boards.board_scene import BoardPose, true_marks
from sim.rig.layout import RigLayout
from tests.pipeline.calibrate.projector.views import observation

LAYOUT = RigLayout().scaled(0.5)
CIRCLES = Board("circles", 7, 6, 40.0, 24.0)
BOARDS = [CIRCLES, Board("acircles", 4, 8, 60.0), Board("chessboard", 7, 5, 40.0),
          Board("charuco", 7, 5, 45.0, marker_mm=33.0, dictionary="DICT_4X4_100")]  # fmt: skip
TILTED = BoardPose((5.0, -4.0, 10.0), (0.5, -0.45, 0.1))


def _both(board: Board, pose: BoardPose, **noise: float) -> dict[str, CameraObservation]:
    return {side: observation(LAYOUT, board, pose, side, **noise) for side in ("left", "right")}


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.kind)
def test_marks_are_exact_without_noise(board: Board) -> None:
    result = projector_marks(board, _both(board, TILTED))
    error = result.marks.pixels - true_marks(LAYOUT, board, TILTED)["projector"][result.marks.ids]
    assert len(result.marks) == len(board.points)
    assert not len(result.rejected)
    assert np.sqrt((error**2).mean()) < 0.001
    assert np.abs(error).max() < 0.004
    assert result.disagreement_px < 0.002


def test_the_centroid_of_a_circle_is_not_its_centre() -> None:
    one = observation(LAYOUT, CIRCLES, TILTED, "left")
    true = true_marks(LAYOUT, CIRCLES, TILTED)["projector"]
    naive = marks_by_camera(CIRCLES, replace(one.marks, areas_px=None), one.x, one.y)
    better = marks_by_camera(CIRCLES, one.marks, one.x, one.y)
    wrong, right = (np.sqrt(((m.pixels - true[m.ids]) ** 2).mean()) for m in (naive, better))
    assert wrong > 0.03
    assert right < wrong / 20


@pytest.mark.parametrize(
    ("phase_px", "mark_px"),
    [*(pytest.param(*each, marks=pytest.mark.long) for each in ((0.2, 0.0), (0.02, 0.02))), (1.0, 0.02)],
)
def test_the_scatter_agrees_with_the_sigma(phase_px: float, mark_px: float) -> None:
    true = true_marks(LAYOUT, CIRCLES, TILTED)["projector"]
    ratios = []
    for seed in range(3):
        result = projector_marks(CIRCLES, _both(CIRCLES, TILTED, phase_px=phase_px, mark_px=mark_px, seed=seed))
        ratios.append((result.marks.pixels - true[result.marks.ids]) / result.marks.sigma_px[:, None])
        assert 0.7 < result.disagreement_px / result.expected_px < 1.4
    assert 0.7 < np.concatenate(ratios).std() < 1.4


def test_a_mark_on_which_the_cameras_disagree_is_rejected() -> None:
    both = _both(CIRCLES, TILTED, phase_px=0.02, mark_px=0.01)
    moved = both["left"].marks.pixels.copy()
    moved[17] += 0.4
    both["left"] = replace(both["left"], marks=replace(both["left"].marks, pixels=moved))
    result = projector_marks(CIRCLES, both)
    assert result.rejected.tolist() == [17]
    assert 17 not in result.marks.ids


def test_a_mark_that_one_camera_detects_is_kept() -> None:
    both = _both(CIRCLES, TILTED, phase_px=0.02, mark_px=0.01)
    there = np.arange(42) != 5
    both["left"] = replace(both["left"], marks=both["left"].marks.some(there))
    result = projector_marks(CIRCLES, both)
    assert 5 in result.marks.ids
    assert result.marks.sigma_px[result.marks.ids == 5] > 1.2 * np.median(result.marks.sigma_px)


def test_phases_beside_the_board_and_wrong_orders_do_not_matter() -> None:
    one = observation(LAYOUT, CIRCLES, TILTED, "left", phase_px=0.02)
    rng = np.random.default_rng(4)
    wild = one.x.px + 12.8 * rng.integers(-2, 3, one.x.px.shape) * (rng.random(one.x.px.shape) < 0.05)
    result = marks_by_camera(CIRCLES, one.marks, replace(one.x, px=wild), one.y)
    error = result.pixels - true_marks(LAYOUT, CIRCLES, TILTED)["projector"][result.ids]
    assert np.abs(error).max() < 0.02


def test_a_camera_without_fringes_is_reported_and_the_other_one_is_used() -> None:
    both = _both(CIRCLES, TILTED)
    nothing = np.full_like(both["left"].x.px, np.nan)
    dark = Coordinate(nothing, nothing, 0 * nothing + 1.0, 0 * nothing + 3.0, np.zeros(nothing.shape, np.bool_))
    dark = replace(dark, amplitude=np.ones_like(nothing), mean=np.ones_like(nothing))
    result = projector_marks(CIRCLES, both | {"left": CameraObservation(both["left"].marks, dark, dark)})
    assert list(result.by_camera) == ["right"]
    assert "projector's light" in result.failed["left"]
    with pytest.raises(TargetError, match=r"left: .* amplitude is 1\.0 counts"):
        projector_marks(CIRCLES, {"left": CameraObservation(both["left"].marks, dark, dark)})
    bright = replace(dark, saturated=np.ones(nothing.shape, np.bool_))
    with pytest.raises(TargetError, match="lower the exposure"):
        projector_marks(CIRCLES, {"left": CameraObservation(both["left"].marks, bright, bright)})
    with pytest.raises(TargetError, match="3 marks detected"):
        projector_marks(CIRCLES, {"left": replace(both["left"], marks=both["left"].marks.some(np.arange(42) < 3))})
