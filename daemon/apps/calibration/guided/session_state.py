"""State machine of a guided session, fed with one observation of the board at a time; no clock, thread or device.

    searching --still at a new pose--> steadying --long enough--> capturing --> checking --> searching ... done
        ^                                   |                         |             |
        +--------------- moved -------------+--------- failed --------+--- moved ---+

``checking`` follows sequences of several images: the observation after the last image shows whether the board moved.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from daemon.apps.calibration.guided.pose_similarity import similar
from pipeline.calibrate.bundle.quality.view_assessment import ViewAssessment, assess_views
from pipeline.calibrate.bundle.quality.view_coverage import ViewGeometry, pooled, view_geometries
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.calibrate.targets.marks import BoardView, Marks

_LEAST_MARKS = 12
_NUMBERED_PX = 2.0


class State(StrEnum):
    """States of a session, see the module's diagram."""

    SEARCHING = "searching"
    STEADYING = "steadying"
    CAPTURING = "capturing"
    CHECKING = "checking"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits for the acceptance of views.

    Args:
        steady_px: largest motion (median over the marks, worst camera) of a still board; steady_s: for how long.
        blurred_px: largest sigma of a sharp edge. saturated: largest share of saturated pixels.
        least: number of views after which the session ends if nothing is missing; most: after which it ends anyway. If
            both are equal, poses do not matter and no advice is given.
    """

    steady_px: float = 0.5
    steady_s: float = 1.0
    blurred_px: float = 3.0
    saturated: float = 0.05
    least: int = 12
    most: int = 24


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One observation of the board.

    Args:
        t_s: time on a monotonic clock.
        detections: by camera; problems: by camera, the reason for a missing detection.
    """

    t_s: float
    detections: Mapping[str, Detection] = field(default_factory=dict)
    problems: Mapping[str, str] = field(default_factory=dict)

    @property
    def marks(self) -> dict[str, Marks]:
        """The marks by camera."""
        return {side: detection.marks for side, detection in self.detections.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Instruction:
    """The next step.

    Args:
        text: one sentence for the person. capture: the caller captures now and reports the result.
        accepted: the view that was just accepted.
        steady: elapsed share of the time for which the board must be still, 0 to 1.
        motion_px: motion of the marks since the steady time began; None if it is not comparable.
    """

    state: State
    text: str
    capture: bool = False
    accepted: BoardView | None = None
    steady: float = 0.0
    motion_px: float | None = None


class Session:
    """Decides when to capture, and when the views suffice.

    Args:
        board: the calibration board; sizes: (width, height) of each camera's images.
        frames: images of the sequence; a view of more than one is checked after the capture.
    """

    def __init__(
        self, board: Board, sizes: Mapping[str, tuple[int, int]], *, limits: Limits | None = None, frames: int = 1
    ) -> None:
        self.board, self.sizes, self.limits = board, dict(sizes), limits or Limits()
        self.views: list[BoardView] = []
        self.rejected = 0
        self.state = State.SEARCHING
        self.advice: ViewAssessment = assess_views(board, [], self.sizes)
        self._frames = frames
        self._poses: list[ViewGeometry] = []
        self._still: deque[Observation] = deque()
        self._pending: dict[str, Marks] | None = None

    @property
    def missing(self) -> tuple[str, ...]:
        """What the views lack, as sentences."""
        return self.advice.missing if self.limits.most > self.limits.least else ()

    @property
    def usual_distance_mm(self) -> float | None:
        """Median distance of the accepted views (:mod:`pipeline.calibrate.bundle.quality.view_coverage`)."""
        return float(np.median([pose.distance_mm for pose in self._poses])) if self._poses else None

    def observe(self, observation: Observation) -> Instruction:
        """Process an observation; none is expected while ``capturing``."""
        if self.state is State.DONE:
            return Instruction(self.state, f"{len(self.views)} views are captured")
        if self.state is State.CHECKING:
            return self._check(observation)
        motion = self._motion(observation)
        problem = self._problem(observation) or self._similar_view(observation)
        if problem:
            self._still.clear()
            self.state = State.SEARCHING
            return Instruction(self.state, problem, motion_px=motion)
        if motion is None or motion > self.limits.steady_px:
            self._still.clear()
        self._still.append(observation)
        held_s = observation.t_s - self._still[0].t_s
        if held_s < self.limits.steady_s:
            self.state = State.STEADYING if len(self._still) > 1 else State.SEARCHING
            text = "hold still" if len(self._still) > 1 else "a new pose: hold the board still"
            return Instruction(self.state, text, steady=held_s / self.limits.steady_s, motion_px=motion)
        self._still.clear()
        self.state = State.CAPTURING
        return Instruction(self.state, "capturing: do not move the board", capture=True, steady=1.0, motion_px=motion)

    def captured(self, observation: Observation) -> Instruction:
        """Process a captured sequence; ``observation`` is that of its white image."""
        problem = self._problem(observation) or self._similar_view(observation)
        if problem:
            return self.failed(problem)
        if self._frames == 1:
            return self._accept(observation.marks)
        self._pending = observation.marks
        self.state = State.CHECKING
        return Instruction(self.state, "hold the board still for a moment longer")

    def failed(self, reason: str) -> Instruction:
        """Discard a failed capture."""
        self.rejected += 1
        self._pending = None
        self.state = State.SEARCHING
        return Instruction(self.state, f"not accepted: {reason}")

    def _check(self, observation: Observation) -> Instruction:
        pending = self._pending or {}
        moved = moved_px(pending, observation.marks)
        if moved is None or moved > self.limits.steady_px:
            change = "is not visible any more" if moved is None else f"moved by {moved:.2f} px"
            return self.failed(f"the board {change} before all images were captured; hold it still until the next pose")
        return self._accept(pending)

    def _accept(self, marks: dict[str, Marks]) -> Instruction:
        view = BoardView(f"view_{len(self.views):02d}", marks)
        self._poses.append(self._pose(view))
        self.views.append(view)
        self._pending = None
        self.advice = assess_views(self.board, self.views, self.sizes)
        enough = len(self.views) >= self.limits.least and not self.missing
        self.state = State.DONE if enough or len(self.views) >= self.limits.most else State.SEARCHING
        text = f"accepted; next: {self.advice.next_pose.text}"
        if self.state is State.DONE:
            lacks = f"still missing: {'; '.join(self.missing)}" if self.missing else "nothing is missing"
            text = f"accepted; {lacks}"
        return Instruction(self.state, text, accepted=view)

    def _problem(self, observation: Observation) -> str:
        """Why this observation cannot become a view; empty if it can."""
        for side in self.sizes:
            detection = observation.detections.get(side)
            if detection is None:
                reason = observation.problems.get(side, "the board is not detected")
                return f"{side} camera: {reason}; next: {self.advice.next_pose.text}"
            if (count := len(detection.marks)) < _LEAST_MARKS:
                return f"{side} camera: only {count} marks are detected, at least {_LEAST_MARKS} are required"
            if (share := detection.saturated) > self.limits.saturated:
                return f"{side} camera: {share:.0%} of the image is saturated; close the aperture or tilt the board"
            if (blur := detection.sharpness_px) > self.limits.blurred_px:
                return (
                    f"{side} camera: blurred (edges of {blur:.1f} px, limit {self.limits.blurred_px:g}); hold still, "
                    "or "
                    "move the board into focus"
                )
        return ""

    def _similar_view(self, observation: Observation) -> str:
        now = self._pose(BoardView("now", observation.marks))
        number = next((k for k, pose in enumerate(self._poses) if similar(now, pose)), None)
        if number is None:
            return ""
        return f"too similar to view {number + 1}; next: {self.advice.next_pose.text}"

    def _pose(self, view: BoardView) -> ViewGeometry:
        per_camera = {side: view_geometries(self.board, [view], side, size) for side, size in self.sizes.items()}
        return pooled(per_camera)[0]

    def _motion(self, observation: Observation) -> float | None:
        """Motion of the board since the steady time began; slow drifts add up."""
        return moved_px(self._still[0].marks, observation.marks) if self._still else None


def moved_px(before: Mapping[str, Marks], after: Mapping[str, Marks]) -> float | None:
    """Motion of the marks in the camera with the larger motion; None if too few marks are common to both.

    The median over marks of the same number. Boards with a symmetry of half a turn may be numbered the other way round
    in the next image; then it is the 95th percentile of the distances to the nearest mark of any number.
    """
    worst = 0.0
    for side, marks in before.items():
        other = after.get(side)
        if other is None:
            return None
        _, first, second = np.intersect1d(marks.ids, other.ids, return_indices=True)
        if len(first) < min(_LEAST_MARKS, len(marks)):
            return None
        same_number = float(np.median(np.linalg.norm(marks.pixels[first] - other.pixels[second], axis=1)))
        if same_number >= _NUMBERED_PX:
            same_number = min(same_number, _from_any_px(marks, other))
        worst = max(worst, same_number)
    return worst if before else None


def _from_any_px(marks: Marks, other: Marks) -> float:
    """Distance of each mark from the nearest one of the other observation, both ways; 95th percentile."""
    gaps = np.linalg.norm(marks.pixels[:, None] - other.pixels[None], axis=2)
    return float(max(np.percentile(gaps.min(axis=1), 95), np.percentile(gaps.min(axis=0), 95)))
