"""The loop of a guided session: observe, decide, capture, store; until the views suffice or the user stops it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from daemon.apps.calibration.guided.capture import CapturedImages, ImageCapture, Progress
from daemon.apps.calibration.guided.session_folder import SessionFolder
from daemon.apps.calibration.guided.session_state import Instruction, Limits, Observation, Session, State
from daemon.apps.calibration.images.image_files import Image, demosaic
from daemon.apps.calibration.views.view import white_frame
from daemon.common.errors import DaemonError
from daemon.live.projection.confirmed_capture import CaptureCancelledError
from drivers.errors import DriverError
from drivers.protocols import SIDES, Clock
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.common.errors import TargetError
from pipeline.pattern.sequence import FrameSequence

Probe = tuple[FrameSequence, Callable[[CapturedImages], str]]
Find = Callable[[Image, Board], Detection]
_MOST_OBSERVATIONS, _MOST_STEADY = 20, 4
"""A simulated hand leaves a pose without a view after more observations and after more times the steady time."""
MOST_FAILURES = 5
"""Consecutive observations that may fail before the session ends."""


@dataclass(frozen=True, slots=True, eq=False)
class SessionUpdate:
    """The state to display after an observation: images by camera, detections, and the instruction."""

    images: dict[str, Image]
    observation: Observation
    instruction: Instruction
    session: Session


class SessionDisplay(Protocol):
    """Displays the progress of a session without delaying it."""

    def show(self, update: SessionUpdate) -> None:
        """Display the state after an observation or a capture."""

    def capturing(self, completed: int, total: int) -> None:
        """Display the progress of a capture."""

    def failure(self, text: str) -> None:
        """Display the reason for a failed observation, which is retried."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a session.

    Args:
        folder: of the captured views. views: their number.
        complete: whether nothing is missing; text: what is missing.
    """

    folder: Path
    views: int
    complete: bool
    text: str


def guide(
    source: ImageCapture,
    board: Board,
    sequence: FrameSequence,
    folder: Path,
    *,
    find: Find,
    display: SessionDisplay,
    clock: Clock,
    limits: Limits | None = None,
    probe: Probe | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Capture a sequence at pose after pose of the board.

    Between the captures the brightest uniform frame of the sequence is projected for the detection of the marks. Every
    accepted view is written at once, so no view is lost when the session ends early.

    Args:
        folder: new folder of this session. find: detects the marks.
        probe: a sequence captured before each capture, and the function that checks it.
        stopped: called between observations.

    Raises:
        DriverError, DaemonError: too many consecutive failures of the devices, or an unusable folder.
    """
    bright = white_frame(sequence)
    white = FrameSequence("white", (sequence.frames[bright],))
    stored = SessionFolder(folder, sequence)
    session: Session | None = None
    pending: CapturedImages | None = None
    failures = stuck = 0
    since_s: float | None = None
    while not stopped() and (session is None or session.state is not State.DONE):
        try:
            captured = source.capture(white)
        except CaptureCancelledError:
            break
        except (DriverError, DaemonError) as error:
            failures += 1
            if failures >= MOST_FAILURES:
                raise
            display.failure(str(error))
            continue
        failures = 0
        session = session or Session(board, captured.sizes, limits=limits, frames=len(sequence))
        images, observation = observe(captured, 0, board, find, clock)
        instruction = session.observe(observation)
        display.show(SessionUpdate(images, observation, instruction, session))
        if instruction.capture:
            problem = _problem(source, probe)
            if problem:
                instruction = session.failed(problem)
            else:
                pending, instruction = _capture(source, sequence, session, board, find, clock, display.capturing)
            display.show(SessionUpdate(images, observation, instruction, session))
        if instruction.accepted is not None and pending is not None:
            stored.add(pending)
            pending = None
            stuck, since_s = 0, None
            if session.state is not State.DONE and source.has_hand and not source.next_pose():
                break
        elif source.has_hand:
            # A simulated hand does not follow instructions: a pose that does not become a view is left.
            stuck += 1
            since_s = observation.t_s if since_s is None else since_s
            if stuck >= _MOST_OBSERVATIONS and observation.t_s - since_s > _MOST_STEADY * session.limits.steady_s:
                stuck, since_s = 0, None
                if not source.next_pose():
                    break
    if session is None:
        return Outcome(folder, 0, False, "no images arrived")
    complete = stored.views >= session.limits.least and not session.missing
    return Outcome(folder, stored.views, complete, "; ".join(session.missing))


def _problem(source: ImageCapture, probe: Probe | None) -> str:
    if probe is None:
        return ""
    try:
        return probe[1](source.capture(probe[0]))
    except (DriverError, DaemonError) as error:
        return str(error)


def _capture(
    source: ImageCapture,
    sequence: FrameSequence,
    session: Session,
    board: Board,
    find: Find,
    clock: Clock,
    progress: Progress,
) -> tuple[CapturedImages | None, Instruction]:
    try:
        captured = source.capture(sequence, progress=progress)
    except (DriverError, DaemonError) as error:
        return None, session.failed(str(error))
    return captured, session.captured(observe(captured, white_frame(sequence), board, find, clock)[1])


def observe(
    captured: CapturedImages, frame: int, board: Board, find: Find, clock: Clock
) -> tuple[dict[str, Image], Observation]:
    """Both cameras' images of one frame, and their detections."""
    t_s = clock.monotonic_ns() / 1e9
    images: dict[str, Image] = {
        side: demosaic(raw, captured.encoding) for side, raw in zip(SIDES, captured.pairs[frame], strict=True)
    }
    detections: dict[str, Detection] = {}
    problems: dict[str, str] = {}
    for side, image in images.items():
        try:
            detections[side] = find(image, board)
        except TargetError as error:
            problems[side] = str(error).rstrip(".")
    return images, Observation(t_s, detections, problems)
