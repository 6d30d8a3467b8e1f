"""What a guided session does with each look at the board; no clock, no thread, no device.

    looking --held still at a new pose--> steadying --long enough--> capturing --> checking --> looking ... done
       ^                                      |                          |            |
       +-------------- moved -----------------+--------- failed ---------+-- it moved-+

``checking`` is there for sequences of several images: the look after the last of them tells whether the board stood
still all the time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np

from daemon.apps.calibration.guided.pose_similarity import alike
from pipeline.calibrate.bundle.quality.view_assessment import ViewAssessment, assess_views
from pipeline.calibrate.bundle.quality.view_coverage import ViewGeometry, pooled, view_geometries
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView, Marks

_LEAST_MARKS = 12
_NUMBERED_PX = 2.0


class State(StrEnum):
    """See the diagram of the module."""

    LOOKING = "looking"
    STEADYING = "steadying"
    CAPTURING = "capturing"
    CHECKING = "checking"
    DONE = "done"


class Detection(Protocol):
    """What a search for marks gives, see :func:`pipeline.calibrate.targets.find_marks.find_marks`."""

    @property
    def marks(self) -> Marks:
        """The marks."""

    @property
    def sharpness_px(self) -> float:
        """Sigma of the edges, px."""

    @property
    def saturated(self) -> float:
        """Share of clipped pixels."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a view must keep.

    Args:
        steady_px: marks that move less (median over the marks, worst camera) stand still; steady_s: for how long.
        blurred_px: an edge with a larger sigma is not sharp. saturated: largest share of clipped pixels.
        wanted: views after which the session ends if the advice misses nothing; most: after which it ends anyway. Where
            both are the same, poses do not matter and nothing is advised.
    """

    steady_px: float = 0.5
    steady_s: float = 1.0
    blurred_px: float = 3.0
    saturated: float = 0.05
    wanted: int = 12
    most: int = 24


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One look.

    Args:
        t_s: when, on any clock that does not go back.
        found: by camera, the marks and how sharp they are; problems: by camera, why there are none.
    """

    t_s: float
    found: Mapping[str, Detection] = field(default_factory=dict)
    problems: Mapping[str, str] = field(default_factory=dict)

    @property
    def marks(self) -> dict[str, Marks]:
        """The marks by camera."""
        return {side: found.marks for side, found in self.found.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What to do now.

    Args:
        text: for the person, one sentence. capture: the caller is to capture now, then to say how that went.
        accepted: the view that has just been taken.
        steady: share of the time that the board must still be held, 0 to 1.
        motion_px: how far the marks moved since the last look; None where they cannot be compared.
    """

    state: State
    text: str
    capture: bool = False
    accepted: BoardView | None = None
    steady: float = 0.0
    motion_px: float | None = None


class Session:
    """Decides when to capture, and when there is enough.

    Args:
        board: what is shown; sizes: (width, height) of each camera's images.
        frames: images of the sequence; a view of more than one is checked after the capture.
    """

    def __init__(
        self, board: Board, sizes: Mapping[str, tuple[int, int]], *, limits: Limits | None = None, frames: int = 1
    ) -> None:
        self.board, self.sizes, self.limits = board, dict(sizes), limits or Limits()
        self.views: list[BoardView] = []
        self.refused = 0
        self.state = State.LOOKING
        self.advice: ViewAssessment = assess_views(board, [], self.sizes)
        self._frames = frames
        self._looks: list[ViewGeometry] = []
        self._still: deque[Sight] = deque()
        self._pending: dict[str, Marks] | None = None

    @property
    def missing(self) -> tuple[str, ...]:
        """What the views lack, in sentences."""
        return self.advice.missing if self.limits.most > self.limits.wanted else ()

    @property
    def usual_distance_mm(self) -> float | None:
        """Median distance of the views so far (:mod:`pipeline.calibrate.bundle.quality.view_coverage`)."""
        return float(np.median([look.distance_mm for look in self._looks])) if self._looks else None

    def look(self, sight: Sight) -> Told:
        """Take a look at the board; while ``capturing`` there is none."""
        if self.state is State.DONE:
            return Told(self.state, f"{len(self.views)} views are taken")
        if self.state is State.CHECKING:
            return self._check(sight)
        motion = self._motion(sight)
        problem = self._problem(sight) or self._too_like(sight)
        if problem:
            self._still.clear()
            self.state = State.LOOKING
            return Told(self.state, problem, motion_px=motion)
        if motion is None or motion > self.limits.steady_px:
            self._still.clear()
        self._still.append(sight)
        held_s = sight.t_s - self._still[0].t_s
        if held_s < self.limits.steady_s:
            self.state = State.STEADYING if len(self._still) > 1 else State.LOOKING
            text = "hold still" if len(self._still) > 1 else "a new pose: hold the board still"
            return Told(self.state, text, steady=held_s / self.limits.steady_s, motion_px=motion)
        self._still.clear()
        self.state = State.CAPTURING
        return Told(self.state, "capturing: do not move the board", capture=True, steady=1.0, motion_px=motion)

    def captured(self, sight: Sight) -> Told:
        """The sequence was captured; ``sight`` is that of its white image."""
        problem = self._problem(sight) or self._too_like(sight)
        if problem:
            return self.failed(problem)
        if self._frames == 1:
            return self._accept(sight.marks)
        self._pending = sight.marks
        self.state = State.CHECKING
        return Told(self.state, "hold still a moment longer")

    def failed(self, reason: str) -> Told:
        """The capture failed; nothing of it counts."""
        self.refused += 1
        self._pending = None
        self.state = State.LOOKING
        return Told(self.state, f"not taken: {reason}")

    def _check(self, sight: Sight) -> Told:
        pending = self._pending or {}
        moved = moved_px(pending, sight.marks)
        if moved is None or moved > self.limits.steady_px:
            how = "is gone" if moved is None else f"moved by {moved:.2f} px"
            return self.failed(f"the board {how} before all images were taken; hold it still until the next pose")
        return self._accept(pending)

    def _accept(self, marks: dict[str, Marks]) -> Told:
        view = BoardView(f"view_{len(self.views):02d}", marks)
        self._looks.append(self._seen(view))
        self.views.append(view)
        self._pending = None
        self.advice = assess_views(self.board, self.views, self.sizes)
        enough = len(self.views) >= self.limits.wanted and not self.missing
        self.state = State.DONE if enough or len(self.views) >= self.limits.most else State.LOOKING
        text = f"taken; next: {self.advice.next_pose.text}"
        if self.state is State.DONE:
            text = f"taken; still missing: {'; '.join(self.missing)}" if self.missing else "taken; nothing is missing"
        return Told(self.state, text, accepted=view)

    def _problem(self, sight: Sight) -> str:
        """Why this look cannot become a view; empty: it can."""
        for side in self.sizes:
            found = sight.found.get(side)
            if found is None:
                told = sight.problems.get(side, "the board is not seen")
                return f"{side} camera: {told}; next: {self.advice.next_pose.text}"
            if len(found.marks) < _LEAST_MARKS:
                return f"{side} camera: only {len(found.marks)} marks are seen, show at least {_LEAST_MARKS}"
            if found.saturated > self.limits.saturated:
                return f"{side} camera: {found.saturated:.0%} of the image is clipped; close the aperture or tilt away"
            if found.sharpness_px > self.limits.blurred_px:
                return (
                    f"{side} camera: blurred (edges of {found.sharpness_px:.1f} px, limit {self.limits.blurred_px:g}); "
                    "hold still, or move into focus"
                )
        return ""

    def _too_like(self, sight: Sight) -> str:
        now = self._seen(BoardView("now", sight.marks))
        like = next((k for k, taken in enumerate(self._looks) if alike(now, taken)), None)
        if like is None:
            return ""
        return f"too like view {like + 1}; next: {self.advice.next_pose.text}"

    def _seen(self, view: BoardView) -> ViewGeometry:
        per_camera = {side: view_geometries(self.board, [view], side, size) for side, size in self.sizes.items()}
        return pooled(per_camera)[0]

    def _motion(self, sight: Sight) -> float | None:
        """How far the board is from where the steady time began; slow drifts add up."""
        return moved_px(self._still[0].marks, sight.marks) if self._still else None


def moved_px(before: Mapping[str, Marks], after: Mapping[str, Marks]) -> float | None:
    """How far the marks moved in the camera where that is most; None if there are too few to tell.

    The median over the marks of the same number. Boards that look alike after half a turn may be numbered the other way
    round in the next image; then what counts is how far the worst marks but 5 % are from any mark of the other look.
    """
    worst = 0.0
    for side, marks in before.items():
        other = after.get(side)
        if other is None:
            return None
        _, here, there = np.intersect1d(marks.ids, other.ids, return_indices=True)
        if len(here) < min(_LEAST_MARKS, len(marks)):
            return None
        same = float(np.median(np.linalg.norm(marks.pixels[here] - other.pixels[there], axis=1)))
        worst = max(worst, same if same < _NUMBERED_PX else min(same, _from_any_px(marks, other)))
    return worst if before else None


def _from_any_px(marks: Marks, other: Marks) -> float:
    """Distance from each mark to the nearest one of the other look, both ways; 95th percentile."""
    gaps = np.linalg.norm(marks.pixels[:, None] - other.pixels[None], axis=2)
    return float(max(np.percentile(gaps.min(axis=1), 95), np.percentile(gaps.min(axis=0), 95)))
