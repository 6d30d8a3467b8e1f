"""The outline that is drawn is that of a board at the pose that is wished for."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.calibrate.live.ghost import USUAL_FOCAL, outline
from pipeline.bundle.advice import Pose, missing
from pipeline.bundle.looks import looks
from pipeline.targets.board import DEFAULT_BOARD
from pipeline.targets.marks import BoardView, Marks

SIZE = (1024, 820)
BOARD = DEFAULT_BOARD


def seen(corners: np.ndarray) -> BoardView:
    """A view of all marks whose outline it is."""
    low, high = BOARD.points.min(axis=0)[:2], BOARD.points.max(axis=0)[:2]
    rectangle = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    h = cv2.getPerspectiveTransform(rectangle.astype(np.float32), corners[:4].astype(np.float32))
    at = np.column_stack([BOARD.points[:, :2], np.ones(len(BOARD.points))]) @ h.T
    n = len(at)
    return BoardView("ghost", {"left": Marks(np.arange(n), at[:, :2] / at[:, 2:], np.full(n, 0.05))})


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    tilt_x=st.floats(-45, 45),
    tilt_y=st.floats(-45, 45),
    u=st.floats(0.2, 0.8),
    v=st.floats(0.2, 0.8),
    distance=st.floats(0.9, 1.1),
)
def test_a_board_that_fills_its_ghost_is_at_the_wished_pose(
    tilt_x: float, tilt_y: float, u: float, v: float, distance: float
) -> None:
    pose = Pose(tilt_x, tilt_y, (u, v), distance, "")
    corners = outline(BOARD, pose, SIZE, distance_mm=1500.0)
    look = looks(BOARD, [seen(corners)], "left", SIZE)[0]
    assert look.tilt_x_deg == pytest.approx(tilt_x, abs=0.02)
    assert look.tilt_y_deg == pytest.approx(tilt_y, abs=0.02)
    assert look.place == pytest.approx((u, v), abs=2e-3)
    assert look.distance_mm == pytest.approx(1500 * distance, rel=1e-3)


def test_the_first_ghost_is_in_the_middle_and_of_a_usual_size() -> None:
    corners = outline(BOARD, missing(BOARD, [], {"left": SIZE}).next_pose, SIZE)
    assert corners[0].tolist() == corners[4].tolist()
    assert np.ptp(corners[:, 0]) == pytest.approx(0.6 * SIZE[0], rel=0.1)
    assert corners[:4].mean(axis=0) == pytest.approx([511.5, 409.5], abs=1)
    assert USUAL_FOCAL * SIZE[0] > SIZE[0]
