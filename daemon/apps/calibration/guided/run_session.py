"""A guided session from a rig file to capture folders: finds out who can show images, and asks for what is needed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Literal

from daemon.apps.calibration.guided.capture import Shooter
from daemon.apps.calibration.guided.capture_from_daemon import DaemonShooter
from daemon.apps.calibration.guided.capture_from_devices import DeviceShooter
from daemon.apps.calibration.guided.capture_loop import Find, Outcome, Probe, Watcher, guide
from daemon.apps.calibration.guided.exposure_check import exposure_problem, full_light
from daemon.apps.calibration.guided.rerun_view import Kind as ViewKind
from daemon.apps.calibration.guided.rerun_view import viewer
from daemon.apps.calibration.guided.session_state import Limits
from daemon.apps.calibration.guided.terminal_view import Bars, Lines, Several, terminal
from daemon.common.clock import SystemClock
from daemon.common.errors import ControlError, DaemonError
from daemon.config import load_rig
from daemon.config.rig_config import RigConfig
from daemon.control.rpc.client import ControlClient
from daemon.rig.open_rig import OptionsError, open_devices
from pipeline.calibrate.targets.board.board import Board
from pipeline.pattern.sequence import FrameSequence, camera_sequence, projector_sequence

What = Literal["cameras", "projector", "color", "all"]
_ASK_S = 1.0
_STILL_PX = 0.3
_HAND_S = 0.2
"""A simulated hand is still at once."""


def ignore(text: str) -> None:
    """Drop a message."""


@dataclass(frozen=True, slots=True)
class Phase:
    """One part of a session.

    Args:
        name: ``board`` (poses of the board) or ``color`` (the board at one place); of its folder, too.
        sequence: captured at every pose. probe: taken before it, see
            :func:`daemon.apps.calibration.guided.capture_loop.guide`.
    """

    name: str
    sequence: FrameSequence
    limits: Limits
    probe: Probe | None = None


def phases(what: What, size: tuple[int, int], *, views: int) -> list[Phase]:
    """What is to be captured.

    Args:
        size: (width, height) of the projector. views: poses of the board, at least.
    """
    if views < 3:
        raise DaemonError(f"--views is {views}, expected at least 3 poses of the board")
    poses = Limits(wanted=views, most=2 * views)
    still = Limits(steady_px=_STILL_PX, wanted=views, most=2 * views)
    once = Limits(steady_px=_STILL_PX, wanted=1, most=1)
    if what == "cameras":
        return [Phase("board", camera_sequence(size), poses)]
    if what == "projector":
        return [Phase("board", projector_sequence(size), still)]
    from pipeline.calibrate.color import color_sequence

    color = Phase("color", color_sequence(size), once, (full_light(size), exposure_problem))
    # Colours first: at the beginning the board faces the rig, and fills the images best.
    return [color] if what == "color" else [color, Phase("board", projector_sequence(size), still)]


def run_session(
    what: What,
    rig: Path,
    board: Board,
    folder: Path | None = None,
    *,
    views: int = 12,
    view: ViewKind = "none",
    find: Find | None = None,
    watcher: Watcher | None = None,
    notify: Callable[[str], None] = ignore,
    progress: Callable[[int, int], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> dict[str, Outcome]:
    """Guide a person (or the simulated hand) through a session.

    A running daemon of this rig is asked; without one the rig's devices are opened.

    Args:
        rig: rig.yaml. folder: of the session; None = a new one under ``calibration-sessions`` beside rig.yaml.
        view: a live view in Rerun. find: finds the marks; None =
            :func:`pipeline.calibrate.targets.find_marks.find_marks`.
        watcher: shows how it goes; None = the terminal. notify: called with each message.
        progress: told (done, of) while a simulated rig is rendered.
        stopped: asked again and again whether to end; what was captured so far stays.

    Returns:
        Outcome of each phase, by its name; phases that were not begun are missing.

    Raises:
        ConfigError, DriverError, DaemonError: nothing can be captured.
    """
    config, base_dir = load_rig(rig, complete=False), rig.resolve().parent
    if find is None:
        from pipeline.calibrate.targets.find_marks import find_marks

        # Whoever solves looks again, and better.
        find = partial(find_marks, refine=False)
    place = folder or new_folder(base_dir / "calibration-sessions", what)
    outcomes: dict[str, Outcome] = {}
    with ExitStack() as stack:
        shooter = open_shooter(config, rig, progress=progress, notify=notify, stopped=stopped)
        stack.callback(shooter.close)
        for note in shooter.notes:
            notify(note)
        shown = stack.enter_context(viewer(view, notify))
        watching = watcher if watcher is not None else _entered(terminal(), stack)
        if shown is not None:
            watching = Several(watching, shown)
        for phase in phases(what, shooter.size, views=views):
            if stopped():
                break
            outcomes[phase.name] = guide(
                shooter,
                board,
                phase.sequence,
                place / phase.name,
                find=find,
                watcher=watching,
                clock=SystemClock(),
                limits=replace(phase.limits, steady_s=_HAND_S) if shooter.has_hand else phase.limits,
                probe=phase.probe,
                stopped=stopped,
            )
    return outcomes


def _entered(bars: Lines | Bars, stack: ExitStack) -> Watcher:
    stack.enter_context(bars)
    return bars


def open_shooter(
    config: RigConfig,
    rig: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
    notify: Callable[[str], None] = ignore,
    stopped: Callable[[], bool] = lambda: False,
) -> Shooter:
    """The running daemon of this rig, or else its devices."""
    try:
        client = ControlClient(config.control.endpoint, timeout_s=_ASK_S)
        try:
            hello = client.call("hello")
        except ControlError:
            client.close()
            raise
    except ControlError:
        notify("no daemon is running: the rig's devices are used directly")
        try:
            devices = open_devices(config, rig.resolve().parent, progress=progress)
        except OptionsError as error:
            raise error.located(rig) from error
        return DeviceShooter(devices, config, cancelled=stopped)
    if "calibrate.capture" not in hello.get("methods", ()):
        client.close()
        raise DaemonError(
            f"the daemon at {config.control.endpoint} (version {hello.get('version')}) cannot capture; stop it, or "
            "start it anew with this version"
        )
    notify(f"the running daemon {hello.get('device')} is asked for the images")
    client.close()
    return DaemonShooter(ControlClient(config.control.endpoint, timeout_s=10.0), cancelled=stopped)


def new_folder(parent: Path, what: str) -> Path:
    """A name that tells when the session was."""
    return parent / f"{what}_{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
