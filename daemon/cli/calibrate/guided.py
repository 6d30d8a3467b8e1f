"""``fringed calibrate cameras|projector|color|all RIG.yaml``: a guided session, then the command on its images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from daemon.apps.calibration.guided.capture_loop import Outcome
from daemon.apps.calibration.guided.rerun_view import Kind as ViewKind
from daemon.apps.calibration.guided.run_session import What, run_session
from daemon.common.errors import DaemonError
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, parse_board


def run(
    step: What,
    rig: Path,
    *,
    board: str = str(DEFAULT_BOARD),
    poses: int = 12,
    view: ViewKind = "none",
    session: Path | None = None,
    **options: Any,
) -> None:
    """Capture live, then calibrate from what was captured.

    Args:
        step: ``cameras``, ``projector``, ``color`` or ``all``. board: see :func:`parse_board`.
        poses: of the board, at least. view: a live view in Rerun.
        session: folder for the images; None = a new one under ``calibration-sessions`` beside rig.yaml.
        options: of the same command on images.

    Raises:
        typer.Exit: the session was stopped; what was captured is on the disk, and the command to go on is told.
    """
    from daemon.bootstrap.run import StopFlag
    from daemon.cli.options.progress import rendering

    with StopFlag().on_signals() as flag, rendering() as progress:
        outcomes = run_session(
            step,
            rig,
            parse_board(board),
            session,
            views=poses,
            view=view,
            say=say,
            progress=progress,
            stopped=lambda: flag.asked,
        )
    if flag.asked:
        tell_rest(step, outcomes)
        raise typer.Exit(130)
    for outcome in outcomes.values():
        if outcome.text:
            say(f"{outcome.folder}: {outcome.views} views; still missing: {outcome.text}")
    solve(step, [outcome.folder for outcome in outcomes.values() if outcome.views], board, options)


def solve(step: What, folders: list[Path], board: str, options: dict[str, Any]) -> None:
    """The command on images, with the folders of a session."""
    from daemon.cli.calibrate import steps

    if not folders:
        raise DaemonError("nothing was captured: there is nothing to calibrate from")
    if step == "color":
        steps.color(views=folders, **options)
        return
    commands: dict[str, Any] = {"cameras": steps.cameras, "projector": steps.projector, "all": steps.everything}
    commands[step](views=folders, board=board, **options)


def tell_rest(step: What, outcomes: dict[str, Outcome]) -> None:
    """What is on the disk after a session that was stopped, and how to go on with it."""
    kept = [outcome for outcome in outcomes.values() if outcome.views]
    if not kept:
        say("stopped; nothing was captured")
        return
    views = " ".join(f"--views {outcome.folder}" for outcome in kept)
    counts = " and ".join(f"{outcome.views} views in {outcome.folder}" for outcome in kept)
    say(f"stopped; kept are {counts}. To calibrate from them: fringed calibrate {step} {views}")


def say(text: str) -> None:
    """A sentence for the person, not for pipes."""
    typer.echo(text, err=True)
