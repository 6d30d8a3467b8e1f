"""A guided session from a rig file to capture folders, through the running daemon or with the rig's devices."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Literal

from daemon.apps.calibration.guided.capture import ImageCapture
from daemon.apps.calibration.guided.capture_from_daemon import CaptureFromDaemon
from daemon.apps.calibration.guided.capture_from_devices import CaptureFromDevices
from daemon.apps.calibration.guided.capture_loop import Find, Outcome, Probe, SessionDisplay, guide
from daemon.apps.calibration.guided.exposure_check import exposure_problem, full_light
from daemon.apps.calibration.guided.rerun_view import Kind as ViewKind
from daemon.apps.calibration.guided.rerun_view import live_view
from daemon.apps.calibration.guided.session_state import Limits
from daemon.apps.calibration.guided.terminal_view import (
    CombinedDisplay,
    PlainDisplay,
    ProgressDisplay,
    terminal_display,
)
from daemon.common.clock import SystemClock
from daemon.common.errors import DaemonError
from daemon.config import load_rig
from daemon.config.rig_config import RigConfig
from daemon.rig.open_rig import OptionsError, open_devices
from fringed.control.client import ControlClient
from fringed.errors import ControlError
from pipeline.calibrate.targets.board.board import Board
from pipeline.pattern.sequence import FrameSequence, camera_sequence, projector_sequence

Step = Literal["cameras", "projector", "color", "all"]
_HELLO_TIMEOUT_S = 1.0
_STILL_PX = 0.3
_HAND_STEADY_S = 0.2
"""A simulated hand is still at once."""


def ignore(text: str) -> None:
    """Drop a message."""


@dataclass(frozen=True, slots=True)
class Stage:
    """One part of a session.

    Args:
        name: ``board`` (poses of the board) or ``color`` (the board at rest); also the name of its folder.
        sequence: captured at every pose. probe: captured before it, see
            :func:`daemon.apps.calibration.guided.capture_loop.guide`.
    """

    name: str
    sequence: FrameSequence
    limits: Limits
    probe: Probe | None = None


def stages(step: Step, size: tuple[int, int], *, views: int) -> list[Stage]:
    """The stages of a session.

    Args:
        size: (width, height) of the projector. views: least number of poses of the board.
    """
    if views < 3:
        raise DaemonError(f"--views is {views}, expected at least 3 poses of the board")
    poses = Limits(least=views, most=2 * views)
    still = Limits(steady_px=_STILL_PX, least=views, most=2 * views)
    once = Limits(steady_px=_STILL_PX, least=1, most=1)
    if step == "cameras":
        return [Stage("board", camera_sequence(size), poses)]
    if step == "projector":
        return [Stage("board", projector_sequence(size), still)]
    from pipeline.calibrate.color import color_sequence

    color = Stage("color", color_sequence(size), once, (full_light(size), exposure_problem))
    # Colours first: at the beginning the board faces the rig and fills the images.
    return [color] if step == "color" else [color, Stage("board", projector_sequence(size), still)]


def run_session(
    step: Step,
    rig: Path,
    board: Board,
    folder: Path | None = None,
    *,
    views: int = 12,
    view: ViewKind = "none",
    find: Find | None = None,
    display: SessionDisplay | None = None,
    notify: Callable[[str], None] = ignore,
    progress: Callable[[int, int], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> dict[str, Outcome]:
    """Guide a person (or the simulated hand) through a session.

    The rig's running daemon captures the images; without one the rig's devices are opened.

    Args:
        rig: rig.yaml. folder: of the session; None = a new one under ``calibration-sessions`` beside rig.yaml.
        view: a live view in Rerun. find: detects the marks; None =
            :func:`pipeline.calibrate.targets.find_marks.find_marks`.
        display: of the progress; None = the terminal. notify: called with each message.
        progress: called with the rendered and the total number of images of a simulated rig.
        stopped: polled; True ends the session, the captured views are kept.

    Returns:
        Outcome of each started stage, by name.

    Raises:
        ConfigError, DriverError, DaemonError: a capture is not possible.
    """
    config, base_dir = load_rig(rig, complete=False), rig.resolve().parent
    if find is None:
        from pipeline.calibrate.targets.find_marks import find_marks

        # The solution detects the marks again with the full refinement.
        find = partial(find_marks, refine=False)
    parent = folder or new_folder(base_dir / "calibration-sessions", step)
    outcomes: dict[str, Outcome] = {}
    with ExitStack() as stack:
        source = open_capture(config, rig, progress=progress, notify=notify, stopped=stopped)
        stack.callback(source.close)
        for note in source.notes:
            notify(note)
        rerun_display = stack.enter_context(live_view(view, notify))
        combined = display if display is not None else _entered(terminal_display(), stack)
        if rerun_display is not None:
            combined = CombinedDisplay(combined, rerun_display)
        for stage in stages(step, source.size, views=views):
            if stopped():
                break
            outcomes[stage.name] = guide(
                source,
                board,
                stage.sequence,
                parent / stage.name,
                find=find,
                display=combined,
                clock=SystemClock(),
                limits=replace(stage.limits, steady_s=_HAND_STEADY_S) if source.has_hand else stage.limits,
                probe=stage.probe,
                stopped=stopped,
            )
    return outcomes


def _entered(bars: PlainDisplay | ProgressDisplay, stack: ExitStack) -> SessionDisplay:
    stack.enter_context(bars)
    return bars


def open_capture(
    config: RigConfig,
    rig: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
    notify: Callable[[str], None] = ignore,
    stopped: Callable[[], bool] = lambda: False,
) -> ImageCapture:
    """Connect to the running daemon of this rig, or open the rig's devices."""
    try:
        client = ControlClient(config.control.endpoint, timeout_s=_HELLO_TIMEOUT_S)
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
        return CaptureFromDevices(devices, config, cancelled=stopped)
    if "calibrate.capture" not in hello.get("methods", ()):
        client.close()
        raise DaemonError(
            f"the daemon at {config.control.endpoint} (version {hello.get('version')}) has no method "
            "calibrate.capture; stop it, or "
            "restart it with this version"
        )
    notify(f"the images are captured by the running daemon {hello.get('device')}")
    client.close()
    return CaptureFromDaemon(ControlClient(config.control.endpoint, timeout_s=10.0), cancelled=stopped)


def new_folder(parent: Path, step: str) -> Path:
    """A folder name with the time of the session."""
    return parent / f"{step}_{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
