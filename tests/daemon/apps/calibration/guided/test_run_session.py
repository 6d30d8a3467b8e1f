"""From a rig file to folders: through a daemon or devices, the stages of a session, and its end."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from daemon.apps.calibration.guided import run_session as run_module
from daemon.apps.calibration.guided.capture import no_progress
from daemon.apps.calibration.guided.run_session import Stage, Step, open_capture, run_session, stages
from daemon.apps.calibration.guided.session_state import Limits
from daemon.apps.calibration.views.open_source import CaptureFolder
from daemon.cli.calibrate.guided import run as run_command
from daemon.common.errors import DaemonError
from daemon.config import driver_table, load_rig
from daemon.control.rpc.protocol import Method
from daemon.control.rpc.server import ControlServer
from pipeline.pattern.sequence import camera_sequence
from tests.daemon.apps.calibration.guided.hand_rig import BOARD, find
from tools.waiting import wait_until

RIG = """
cameras: {{driver: hand}}
stream: {{endpoints: ["ipc://{tmp}/s"]}}
control: {{endpoint: "ipc://{tmp}/c"}}
"""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setitem(driver_table.RIGS, "hand", "tests.daemon.apps.calibration.guided.hand_rig:open_rig")
    path = tmp_path / "rig.yaml"
    path.write_text(RIG.format(tmp=tmp_path))
    return path


def test_without_a_daemon_the_devices_are_used_and_every_stage_gets_its_folder(
    rig: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def short(_: Step, size: tuple[int, int], *, views: int) -> list[Stage]:
        poses = Limits(least=views, most=views)
        return [
            Stage("color", camera_sequence(size), Limits(least=1, most=1)),
            Stage("board", camera_sequence(size), poses),
        ]

    monkeypatch.setattr(run_module, "stages", short)
    messages: list[str] = []
    outcomes = run_session("all", rig, BOARD, rig.parent / "s", views=3, find=find, notify=messages.append)
    assert {name: outcome.views for name, outcome in outcomes.items()} == {"color": 1, "board": 3}
    assert messages == ["no daemon is running: the rig's devices are used directly"]
    for name, outcome in outcomes.items():
        assert outcome.folder == rig.parent / "s" / name
        assert len(list(CaptureFolder(outcome.folder).views(no_progress))) == outcome.views


def test_the_step_all_begins_with_the_colours_and_their_exposure_check() -> None:
    color, board = stages("all", (640, 480), views=9)
    assert (color.name, color.sequence.name, color.limits.most) == ("color", "color", 1)
    assert (board.name, board.sequence.name, board.limits.least) == ("board", "projector", 9)
    assert color.probe is not None and len(color.probe[0]) == 3 and board.probe is None


def test_a_session_folder_is_named_by_its_time(rig: Path) -> None:
    outcome = run_session("color", rig, BOARD, find=find)["color"]
    assert outcome.folder.parent.parent == rig.parent / "calibration-sessions"
    assert outcome.folder.parent.name.startswith("color_2")


def test_a_daemon_without_the_capture_method_is_rejected(rig: Path) -> None:
    hello = {"methods": ["hello"], "version": "0.0.1", "device": "old"}
    server = ControlServer(load_rig(rig, complete=False).control.endpoint, {"hello": Method(lambda _: hello)})
    server.start()
    try:
        with pytest.raises(DaemonError, match=r"version 0\.0\.1\) has no method calibrate.capture"):
            open_capture(load_rig(rig, complete=False), rig)
    finally:
        server.close()


def test_too_few_views_are_rejected() -> None:
    with pytest.raises(DaemonError, match="--views is 2"):
        stages("cameras", (64, 48), views=2)


@pytest.mark.parametrize("step", ["cameras", "projector", "color"])
def test_each_step_captures_its_own_sequence(step: Step) -> None:
    assert [stage.sequence.name for stage in stages(step, (640, 480), views=3)] == [step]


_PROGRAM = """
import sys
from pathlib import Path
from daemon.config import driver_table
from daemon.cli.calibrate import guided
from daemon.apps.calibration.guided import run_session
from tests.daemon.apps.calibration.guided import hand_rig
driver_table.RIGS["hand"] = "tests.daemon.apps.calibration.guided.hand_rig:open_rig"
run_session.run_session.__kwdefaults__["find"] = hand_rig.find
from typer import Exit
try:
    guided.run("projector", Path(sys.argv[1]), print, session=Path(sys.argv[2]), poses=9)
except Exit as stop:
    sys.exit(stop.exit_code)
"""


@pytest.mark.slow
def test_ctrl_c_keeps_the_captured_views_and_prints_the_command_that_continues(rig: Path) -> None:
    session = rig.parent / "s"
    command = [sys.executable, "-c", _PROGRAM, str(rig), str(session)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        wait_until((session / "board" / "view_01").exists, 60)
        process.send_signal(signal.SIGINT)
        _, output = process.communicate(timeout=30)
    assert process.returncode == 130, output
    views = len(list(CaptureFolder(session / "board").views(lambda *_: None)))
    assert f"kept {views} views in {session / 'board'}" in output
    assert f"fringed calibrate projector --views {session / 'board'}" in output


def test_a_session_without_views_is_an_error(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.cli.calibrate.guided.run_session", lambda *_, **__: {})
    with pytest.raises(DaemonError, match="captured no view"):
        run_command("cameras", rig, lambda _: None)
