"""The guided session captures what is held still, sharp and new, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.apps.calibration.guided.session_state import Limits, Session, Sight, State, Told, moved_px
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.calibrate.targets.marks import BoardView, Marks
from tests.pipeline.calibrate.bundle.sessions import session as made_session

VIEWS, SIZES, _ = made_session(n=16, devices=("left", "right"), seed=3)
STEP_S = 0.25
LIMITS = Limits(steady_px=0.5, steady_s=1.0, wanted=4, most=6)


@dataclass(frozen=True)
class Seen:
    marks: Marks
    sharpness_px: float = 1.0
    saturated: float = 0.0


def sight(view: BoardView, t_s: float, *, shift: float = 0.0, **flaws: float) -> Sight:
    moved = {side: replace(marks, pixels=marks.pixels + np.array([shift, 0.0])) for side, marks in view.marks.items()}
    return Sight(t_s, {side: Seen(marks, **flaws) for side, marks in moved.items()})


class Clock:
    def __init__(self) -> None:
        self.t_s = 0.0

    def next(self) -> float:
        self.t_s += STEP_S
        return self.t_s


def held(session: Session, view: BoardView, clock: Clock, looks: int = 6) -> Told:
    """Hold a pose until it is captured, or for so many looks."""
    told = Told(session.state, "")
    for _ in range(looks):
        told = session.look(sight(view, clock.next()))
        if told.capture:
            return session.captured(sight(view, clock.next()))
    return told


def made(frames: int = 1) -> Session:
    return Session(DEFAULT_BOARD, SIZES, limits=LIMITS, frames=frames)


def test_poses_that_are_held_still_are_taken_one_after_the_other_until_there_is_enough() -> None:
    session, clock = made(), Clock()
    for view in VIEWS[:5]:
        told = held(session, view, clock)
        assert told.accepted is not None
        assert "next: " in told.text
    told = held(session, VIEWS[5], clock)
    assert session.state is State.DONE and len(session.views) == 6
    assert told.text.startswith("taken; still missing: ")
    assert session.look(sight(VIEWS[6], clock.next())).text == "6 views are taken"
    assert [view.name for view in session.views] == [f"view_{n:02d}" for n in range(6)]


def test_a_good_session_ends_when_nothing_is_missing() -> None:
    session, clock = Session(DEFAULT_BOARD, SIZES, limits=Limits(wanted=10, most=16)), Clock()
    taken = 0
    for view in VIEWS:
        if session.state is not State.DONE:
            taken += held(session, view, clock).accepted is not None
    assert session.state is State.DONE
    assert session.advice.enough or taken == 16


def test_a_board_that_moves_is_never_captured() -> None:
    session, clock = made(), Clock()
    for n in range(50):
        told = session.look(sight(VIEWS[0], clock.next(), shift=0.6 * n))
        assert not told.capture and told.steady == 0.0


def test_a_board_that_creeps_is_not_held_still() -> None:
    """Each step is small, the sum of them is not."""
    session, clock = made(), Clock()
    for n in range(50):
        assert not session.look(sight(VIEWS[0], clock.next(), shift=0.2 * n)).capture


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.floats(0.05, 0.6), st.floats(-0.4, 0.4)), min_size=5, max_size=40))
def test_what_is_captured_was_still_for_the_whole_time(steps: list[tuple[float, float]]) -> None:
    session, t_s, shift = made(), 0.0, 0.0
    past: list[tuple[float, float]] = []
    for pause_s, step in steps:
        t_s, shift = t_s + pause_s, shift + step
        past.append((t_s, shift))
        if session.look(sight(VIEWS[0], t_s, shift=shift)).capture:
            start = max(t for t, _ in past if t <= t_s - LIMITS.steady_s + 1e-9)
            during = [s for t, s in past if t >= start]
            assert max(during) - min(during) <= 2 * LIMITS.steady_px
            return


def test_a_pose_like_one_before_is_refused_and_told_which_to_show() -> None:
    session, clock = made(), Clock()
    held(session, VIEWS[0], clock)
    told = held(session, VIEWS[0], clock)
    assert not told.accepted and told.text.startswith("too like view 1; next: ")
    assert held(session, VIEWS[1], clock).accepted is not None


@pytest.mark.parametrize(
    ("flaws", "told"),
    [
        ({"sharpness_px": 5.0}, "left camera: blurred"),
        ({"saturated": 0.2}, "left camera: 20% of the image is clipped"),
    ],
)
def test_images_that_would_spoil_the_calibration_are_not_taken(flaws: dict[str, float], told: str) -> None:
    session, clock = made(), Clock()
    for _ in range(10):
        said = session.look(sight(VIEWS[0], clock.next(), **flaws))
        assert not said.capture and said.text.startswith(told)


def test_a_camera_that_sees_nothing_is_named_with_the_reason() -> None:
    session = made()
    only_left = Sight(1.0, {"left": Seen(VIEWS[0].marks["left"])}, {"right": "no circles"})
    assert session.look(only_left).text.startswith("right camera: no circles; next: ")
    few = VIEWS[0].marks["right"].some(np.arange(len(VIEWS[0].marks["right"])) < 5)
    assert "only 5 marks" in session.look(Sight(2.0, {"left": Seen(VIEWS[0].marks["left"]), "right": Seen(few)})).text


def test_the_board_must_stand_still_during_a_whole_sequence() -> None:
    session, clock = made(frames=22), Clock()
    assert held(session, VIEWS[0], clock).state is State.CHECKING
    told = session.look(sight(VIEWS[0], clock.next(), shift=0.8))
    assert told.accepted is None and "moved by 0.80 px before all images were taken" in told.text
    assert session.state is State.LOOKING and session.refused == 1 and not session.views
    assert held(session, VIEWS[0], clock).state is State.CHECKING
    assert "is gone before" in session.look(Sight(clock.next())).text
    assert held(session, VIEWS[0], clock).state is State.CHECKING
    assert session.look(sight(VIEWS[0], clock.next(), shift=0.1)).accepted is not None


def test_a_capture_that_failed_counts_for_nothing() -> None:
    session, clock = made(), Clock()
    for _ in range(5):
        told = session.look(sight(VIEWS[0], clock.next()))
    assert told.capture and session.state is State.CAPTURING
    assert session.failed("the cable is out").text == "not taken: the cable is out"
    assert held(session, VIEWS[0], clock).accepted is not None


def test_motion_is_that_of_the_worse_camera_and_of_marks_seen_twice() -> None:
    marks = VIEWS[0].marks
    away = {"left": marks["left"], "right": replace(marks["right"], pixels=marks["right"].pixels + 3.0)}
    assert moved_px(marks, away) == pytest.approx(3 * np.sqrt(2))
    assert moved_px(marks, {"left": marks["left"]}) is None
    assert moved_px({}, {}) is None


def test_a_board_that_is_numbered_the_other_way_round_has_not_moved_and_one_that_slid_by_a_pitch_has() -> None:
    marks = VIEWS[0].marks["left"]
    turned = replace(marks, ids=marks.ids[::-1].copy())
    assert moved_px({"left": marks}, {"left": turned}) == 0.0
    pitch = marks.pixels[1] - marks.pixels[0]
    slid = moved_px({"left": marks}, {"left": replace(turned, pixels=turned.pixels + pitch)})
    assert slid is not None and slid > 5.0
