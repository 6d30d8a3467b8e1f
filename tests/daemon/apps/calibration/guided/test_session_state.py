"""The guided session captures only still, sharp and new poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.apps.calibration.guided.session_state import Instruction, Limits, Observation, Session, State, moved_px
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.calibrate.targets.marks import BoardView, Marks
from tests.pipeline.calibrate.bundle.sessions import session as made_session

VIEWS, SIZES, _ = made_session(n=16, devices=("left", "right"), seed=3)
STEP_S = 0.25
LIMITS = Limits(steady_px=0.5, steady_s=1.0, least=4, most=6)


def detection(marks: Marks, *, sharpness_px: float = 1.0, saturated: float = 0.0) -> Detection:
    return Detection(marks, sharpness_px, 0.9, saturated)


def observation(view: BoardView, t_s: float, *, shift: float = 0.0, **flaws: float) -> Observation:
    moved = {side: replace(marks, pixels=marks.pixels + np.array([shift, 0.0])) for side, marks in view.marks.items()}
    return Observation(t_s, {side: detection(marks, **flaws) for side, marks in moved.items()})


class Clock:
    def __init__(self) -> None:
        self.t_s = 0.0

    def next(self) -> float:
        self.t_s += STEP_S
        return self.t_s


def held(session: Session, view: BoardView, clock: Clock, observations: int = 6) -> Instruction:
    """Hold a pose until it is captured, or for a number of observations."""
    instruction = Instruction(session.state, "")
    for _ in range(observations):
        instruction = session.observe(observation(view, clock.next()))
        if instruction.capture:
            return session.captured(observation(view, clock.next()))
    return instruction


def new_session(frames: int = 1) -> Session:
    return Session(DEFAULT_BOARD, SIZES, limits=LIMITS, frames=frames)


def test_still_poses_are_captured_one_after_the_other_until_the_views_suffice() -> None:
    session, clock = new_session(), Clock()
    for view in VIEWS[:5]:
        instruction = held(session, view, clock)
        assert instruction.accepted is not None
        assert "next: " in instruction.text
    instruction = held(session, VIEWS[5], clock)
    assert session.state is State.DONE and len(session.views) == 6
    assert instruction.text.startswith("accepted; still missing: ")
    assert session.observe(observation(VIEWS[6], clock.next())).text == "6 views are captured"
    assert [view.name for view in session.views] == [f"view_{n:02d}" for n in range(6)]


def test_a_good_session_ends_when_nothing_is_missing() -> None:
    session, clock = Session(DEFAULT_BOARD, SIZES, limits=Limits(least=10, most=16)), Clock()
    accepted = 0
    for view in VIEWS:
        if session.state is not State.DONE:
            accepted += held(session, view, clock).accepted is not None
    assert session.state is State.DONE
    assert session.advice.enough or accepted == 16


def test_a_board_that_moves_is_never_captured() -> None:
    session, clock = new_session(), Clock()
    for n in range(50):
        instruction = session.observe(observation(VIEWS[0], clock.next(), shift=0.6 * n))
        assert not instruction.capture and instruction.steady == 0.0


def test_a_slowly_drifting_board_is_not_still() -> None:
    """Each step is small, the sum of them is not."""
    session, clock = new_session(), Clock()
    for n in range(50):
        assert not session.observe(observation(VIEWS[0], clock.next(), shift=0.2 * n)).capture


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(0.05, 0.6), st.floats(-0.4, 0.4)), min_size=5, max_size=40))
def test_a_captured_board_was_still_for_the_whole_time(steps: list[tuple[float, float]]) -> None:
    session, t_s, shift = new_session(), 0.0, 0.0
    past: list[tuple[float, float]] = []
    for pause_s, step in steps:
        t_s, shift = t_s + pause_s, shift + step
        past.append((t_s, shift))
        if session.observe(observation(VIEWS[0], t_s, shift=shift)).capture:
            start = max(t for t, _ in past if t <= t_s - LIMITS.steady_s + 1e-9)
            during = [s for t, s in past if t >= start]
            assert max(during) - min(during) <= 2 * LIMITS.steady_px
            return


def test_a_pose_similar_to_an_earlier_one_is_rejected_with_the_next_pose() -> None:
    session, clock = new_session(), Clock()
    held(session, VIEWS[0], clock)
    instruction = held(session, VIEWS[0], clock)
    assert not instruction.accepted and instruction.text.startswith("too similar to view 1; next: ")
    assert held(session, VIEWS[1], clock).accepted is not None


@pytest.mark.parametrize(
    ("flaws", "message"),
    [
        ({"sharpness_px": 5.0}, "left camera: blurred"),
        ({"saturated": 0.2}, "left camera: 20% of the image is saturated"),
    ],
)
def test_blurred_and_saturated_images_are_not_accepted(flaws: dict[str, float], message: str) -> None:
    session, clock = new_session(), Clock()
    for _ in range(10):
        instruction = session.observe(observation(VIEWS[0], clock.next(), **flaws))
        assert not instruction.capture and instruction.text.startswith(message)


def test_a_camera_without_detection_is_named_with_the_reason() -> None:
    session = new_session()
    only_left = Observation(1.0, {"left": detection(VIEWS[0].marks["left"])}, {"right": "no circles"})
    assert session.observe(only_left).text.startswith("right camera: no circles; next: ")
    few = VIEWS[0].marks["right"].some(np.arange(len(VIEWS[0].marks["right"])) < 5)
    assert (
        "only 5 marks"
        in session.observe(Observation(2.0, {"left": detection(VIEWS[0].marks["left"]), "right": detection(few)})).text
    )


def test_the_board_must_be_still_during_a_whole_sequence() -> None:
    session, clock = new_session(frames=22), Clock()
    assert held(session, VIEWS[0], clock).state is State.CHECKING
    instruction = session.observe(observation(VIEWS[0], clock.next(), shift=0.8))
    assert instruction.accepted is None and "moved by 0.80 px before all images were captured" in instruction.text
    assert session.state is State.SEARCHING and session.rejected == 1 and not session.views
    assert held(session, VIEWS[0], clock).state is State.CHECKING
    assert "is not visible any more before" in session.observe(Observation(clock.next())).text
    assert held(session, VIEWS[0], clock).state is State.CHECKING
    assert session.observe(observation(VIEWS[0], clock.next(), shift=0.1)).accepted is not None


def test_a_failed_capture_adds_no_view() -> None:
    session, clock = new_session(), Clock()
    for _ in range(5):
        instruction = session.observe(observation(VIEWS[0], clock.next()))
    assert instruction.capture and session.state is State.CAPTURING
    assert session.failed("the cable is out").text == "not accepted: the cable is out"
    assert held(session, VIEWS[0], clock).accepted is not None


def test_motion_is_that_of_the_worse_camera_and_of_common_marks() -> None:
    marks = VIEWS[0].marks
    away = {"left": marks["left"], "right": replace(marks["right"], pixels=marks["right"].pixels + 3.0)}
    assert moved_px(marks, away) == pytest.approx(3 * np.sqrt(2))
    assert moved_px(marks, {"left": marks["left"]}) is None
    assert moved_px({}, {}) is None


def test_a_reversed_numbering_is_no_motion_and_a_shift_by_a_pitch_is() -> None:
    marks = VIEWS[0].marks["left"]
    turned = replace(marks, ids=marks.ids[::-1].copy())
    assert moved_px({"left": marks}, {"left": turned}) == 0.0
    pitch = marks.pixels[1] - marks.pixels[0]
    slid = moved_px({"left": marks}, {"left": replace(turned, pixels=turned.pixels + pitch)})
    assert slid is not None and slid > 5.0
