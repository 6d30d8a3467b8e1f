"""``fringed calibrate cameras|projector|color|all RIG.yaml``: a guided session, then the command on its images."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import typer

from daemon.apps.calibration.guided.capture_loop import Outcome
from daemon.apps.calibration.guided.rerun_view import Kind as ViewKind
from daemon.apps.calibration.guided.run_session import Step, run_session
from daemon.bootstrap.run import StopFlag
from daemon.cli.options.progress import rendering
from daemon.common.errors import DaemonError
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, parse_board


def run(
    step: Step,
    rig: Path,
    solve: Callable[[list[Path]], None],
    *,
    board: str = str(DEFAULT_BOARD),
    poses: int = 12,
    view: ViewKind = "none",
    session: Path | None = None,
) -> None:
    """Capture with a rig, then calibrate from the captured images.

    Args:
        step: ``cameras``, ``projector``, ``color`` or ``all``. board: see :func:`parse_board`.
        solve: the same command on images, given the session's folders.
        poses: least number of poses of the board. view: a live view in Rerun.
        session: folder for the images; None = a new one under ``calibration-sessions`` beside rig.yaml.

    Raises:
        typer.Exit: the session was stopped; the captured views are on disk, and the command that continues is printed.
    """
    with StopFlag().on_signals() as flag, rendering() as progress:
        outcomes = run_session(
            step,
            rig,
            parse_board(board),
            session,
            views=poses,
            view=view,
            notify=notify,
            progress=progress,
            stopped=lambda: flag.requested,
        )
    captured = [outcome for outcome in outcomes.values() if outcome.views]
    if flag.requested:
        notify(stopped_text(step, captured))
        raise typer.Exit(130)
    for outcome in outcomes.values():
        if outcome.text:
            notify(f"{outcome.folder}: {outcome.views} views; still missing: {outcome.text}")
    if not captured:
        raise DaemonError("the session captured no view: there is nothing to calibrate from")
    solve([outcome.folder for outcome in captured])


def stopped_text(step: Step, captured: list[Outcome]) -> str:
    """The captured views of a stopped session, and the command that continues with them."""
    if not captured:
        return "stopped; no view was captured"
    views = " ".join(f"--views {outcome.folder}" for outcome in captured)
    counts = " and ".join(f"{outcome.views} views in {outcome.folder}" for outcome in captured)
    return f"stopped; kept {counts}. To calibrate from them: fringed calibrate {step} {views}"


def notify(text: str) -> None:
    """Print a sentence for the person on standard error, away from pipes."""
    typer.echo(text, err=True)
