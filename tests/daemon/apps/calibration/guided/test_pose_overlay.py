"""The drawn outline is that of a board at the requested pose."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.apps.calibration.guided.pose_overlay import USUAL_FOCAL, outline, within
from pipeline.calibrate.bundle.quality.view_assessment import Pose, assess_views
from pipeline.calibrate.bundle.quality.view_coverage import view_geometries
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.calibrate.targets.marks import BoardView, Marks

SIZE = (1024, 820)
BOARD = DEFAULT_BOARD


def view_of(corners: np.ndarray) -> BoardView:
    """The view of all marks with this outline."""
    low, high = BOARD.points.min(axis=0)[:2], BOARD.points.max(axis=0)[:2]
    rectangle = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    h = cv2.getPerspectiveTransform(rectangle.astype(np.float32), corners[:4].astype(np.float32))
    at = np.column_stack([BOARD.points[:, :2], np.ones(len(BOARD.points))]) @ h.T
    n = len(at)
    return BoardView("overlay", {"left": Marks(np.arange(n), at[:, :2] / at[:, 2:], np.full(n, 0.05))})


@settings(max_examples=100, deadline=None)
@given(
    tilt_x=st.floats(-45, 45),
    tilt_y=st.floats(-45, 45),
    u=st.floats(0.2, 0.8),
    v=st.floats(0.2, 0.8),
    distance=st.floats(0.9, 1.1),
)
def test_a_board_that_fills_its_outline_is_at_the_requested_pose(
    tilt_x: float, tilt_y: float, u: float, v: float, distance: float
) -> None:
    pose = Pose(tilt_x, tilt_y, (u, v), distance, "")
    corners = outline(BOARD, pose, SIZE, distance_mm=1500.0)
    found = view_geometries(BOARD, [view_of(corners)], "left", SIZE)[0]
    assert found.tilt_x_deg == pytest.approx(tilt_x, abs=0.02)
    assert found.tilt_y_deg == pytest.approx(tilt_y, abs=0.02)
    assert found.position == pytest.approx((u, v), abs=2e-3)
    assert found.distance_mm == pytest.approx(1500 * distance, rel=1e-3)


def test_the_first_outline_is_in_the_middle_and_of_a_usual_size() -> None:
    corners = outline(BOARD, assess_views(BOARD, [], {"left": SIZE}).next_pose, SIZE)
    assert corners[0].tolist() == corners[4].tolist()
    assert np.ptp(corners[:, 0]) == pytest.approx(0.6 * SIZE[0], rel=0.1)
    assert corners[:4].mean(axis=0) == pytest.approx([511.5, 409.5], abs=1)
    assert USUAL_FOCAL * SIZE[0] > SIZE[0]


@settings(max_examples=100, deadline=None)
@given(u=st.floats(-0.5, 1.5), v=st.floats(-0.5, 1.5), tilt=st.floats(-45, 45), distance_mm=st.floats(400.0, 3000.0))
def test_an_outline_is_moved_into_the_image_and_one_inside_it_is_unchanged(
    u: float, v: float, tilt: float, distance_mm: float
) -> None:
    corners = outline(BOARD, Pose(tilt, 10.0, (u, v), 1.0, ""), SIZE, distance_mm=distance_mm)
    inside = within(corners, SIZE)
    edge = 0.03 * np.array(SIZE)
    assert (inside >= edge - 1e-6).all() and (inside <= np.array(SIZE) - edge + 1e-6).all()
    assert within(inside, SIZE) == pytest.approx(inside, abs=1e-6)
