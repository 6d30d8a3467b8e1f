"""Runs a guided session: look, decide, capture, keep; until there is enough or somebody stops it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from daemon.apps.calibration.guided.capture import Progress, Shooter, Shots
from daemon.apps.calibration.guided.session_folder import SessionFolder
from daemon.apps.calibration.guided.session_state import Detection, Limits, Session, Sight, State, Told
from daemon.apps.calibration.images.image_files import Image, unpacked
from daemon.apps.calibration.views.view import white_frame
from daemon.common.errors import DaemonError
from daemon.live.projection.confirmed_capture import CaptureCancelledError
from drivers.errors import DriverError
from drivers.protocols import SIDES, Clock
from pipeline.calibrate.targets.board.board import Board
from pipeline.common.errors import TargetError
from pipeline.pattern.sequence import FrameSequence

Probe = tuple[FrameSequence, Callable[[Shots], str]]
Find = Callable[[Image, Board], Detection]
_MOST_LOOKS, _MOST_STEADY = 20, 4
"""A simulated hand leaves a pose that became no view after more looks, and after more times the steady time."""
MOST_FAILURES = 5
"""Looks in a row that may fail before the session ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What there is to show after a look: images by camera, what was found in them, and what to do."""

    images: dict[str, Image]
    sight: Sight
    told: Told
    session: Session


class Watcher(Protocol):
    """Shows how a session goes; it must not hold it up."""

    def seen(self, scene: Scene) -> None:
        """After every look and every capture."""

    def capturing(self, done: int, of: int) -> None:
        """While a sequence is shown."""

    def trouble(self, text: str) -> None:
        """A look failed; it is tried again."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a session ended.

    Args:
        folder: of the captured views. views: how many are in it.
        complete: whether nothing is missing; text: what is.
    """

    folder: Path
    views: int
    complete: bool
    text: str


def guide(
    shooter: Shooter,
    board: Board,
    sequence: FrameSequence,
    folder: Path,
    *,
    find: Find,
    watcher: Watcher,
    clock: Clock,
    limits: Limits | None = None,
    probe: Probe | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Capture a sequence at pose after pose of the board.

    Between the captures the brightest even image of the sequence is shown, on which the marks are found. Every view
    is on the disk as soon as it is accepted, so whatever ends the session, nothing of it is lost.

    Args:
        folder: of this session, new. find: finds the marks.
        probe: images that are taken before each capture, and what says what is wrong with them.
        stopped: asked between looks.

    Raises:
        DriverError, DaemonError: the devices failed too often in a row, or the folder cannot be used.
    """
    bright = white_frame(sequence)
    white = FrameSequence("look", (sequence.frames[bright],))
    kept = SessionFolder(folder, sequence)
    session: Session | None = None
    pending: Shots | None = None
    failures = stuck = 0
    since_s: float | None = None
    while not stopped() and (session is None or session.state is not State.DONE):
        try:
            shots = shooter.shoot(white)
        except CaptureCancelledError:
            break
        except (DriverError, DaemonError) as error:
            failures += 1
            if failures >= MOST_FAILURES:
                raise
            watcher.trouble(str(error))
            continue
        failures = 0
        session = session or Session(board, shots.sizes, limits=limits, frames=len(sequence))
        images, sight = sighted(shots, 0, board, find, clock)
        told = session.look(sight)
        watcher.seen(Scene(images, sight, told, session))
        if told.capture:
            problem = _problem(shooter, probe)
            if problem:
                told = session.failed(problem)
            else:
                pending, told = _capture(shooter, sequence, session, board, find, clock, watcher.capturing)
            watcher.seen(Scene(images, sight, told, session))
        if told.accepted is not None and pending is not None:
            kept.add(pending)
            pending = None
            stuck, since_s = 0, None
            if session.state is not State.DONE and shooter.has_hand and not shooter.next_pose():
                break
        elif shooter.has_hand:
            # Nobody is there to do as told: a pose that does not become a view is left.
            stuck += 1
            since_s = sight.t_s if since_s is None else since_s
            if stuck >= _MOST_LOOKS and sight.t_s - since_s > _MOST_STEADY * session.limits.steady_s:
                stuck, since_s = 0, None
                if not shooter.next_pose():
                    break
    if session is None:
        return Outcome(folder, 0, False, "no image came")
    complete = kept.views >= session.limits.wanted and not session.missing
    return Outcome(folder, kept.views, complete, "; ".join(session.missing))


def _problem(shooter: Shooter, probe: Probe | None) -> str:
    if probe is None:
        return ""
    try:
        return probe[1](shooter.shoot(probe[0]))
    except (DriverError, DaemonError) as error:
        return str(error)


def _capture(
    shooter: Shooter,
    sequence: FrameSequence,
    session: Session,
    board: Board,
    find: Find,
    clock: Clock,
    progress: Progress,
) -> tuple[Shots | None, Told]:
    try:
        shots = shooter.shoot(sequence, progress=progress)
    except (DriverError, DaemonError) as error:
        return None, session.failed(str(error))
    return shots, session.captured(sighted(shots, white_frame(sequence), board, find, clock)[1])


def sighted(shots: Shots, frame: int, board: Board, find: Find, clock: Clock) -> tuple[dict[str, Image], Sight]:
    """Both cameras' images of one frame, and the marks in them."""
    t_s = clock.monotonic_ns() / 1e9
    images: dict[str, Image] = {
        side: unpacked(raw, shots.encoding) for side, raw in zip(SIDES, shots.pairs[frame], strict=True)
    }
    found: dict[str, Detection] = {}
    problems: dict[str, str] = {}
    for side, image in images.items():
        try:
            found[side] = find(image, board)
        except TargetError as error:
            problems[side] = str(error).rstrip(".")
    return images, Sight(t_s, found, problems)
