"""The commands on a simulated rig with a simulated hand produce a calibration unattended."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from daemon.rig.calibration_file import read_calibration, read_cameras
from fringed.control.client import ControlClient
from fringed.errors import NoDaemonError
from sim.rig.layout import RigLayout
from tools.waiting import wait_until

EXAMPLE = Path(__file__).resolve().parents[4] / "examples" / "calibrate-sim.yaml"
SCALE, BOARD = 0.25, "circles:11x9:32:20"
"""Of the example."""
SMALL = 0.15, "circles:8x6:46:30"
"""Fewer pixels, and marks that are large enough for them."""

PROGRAM = "from daemon.cli.entry import main; main()"
DAEMON = """
import sys
from pathlib import Path
from daemon.bootstrap.run import StopFlag, run_rig
from daemon.live.service import Service
from tests.daemon.lit_rig import FlatReconstructor
from tools.waiting import wait_until
Service._warm = lambda self: FlatReconstructor()
with StopFlag().on_signals() as flag:
    run_rig(Path(sys.argv[1]), flag=flag)
"""


def rig_file(tmp_path: Path, *, poses: int, scale: float = SCALE, board: str = BOARD) -> Path:
    data = yaml.safe_load(EXAMPLE.read_text())
    data["simulation"] |= {"poses": poses, "rate_hz": 50.0, "board": board, "layout": {"scale": scale}}
    data |= {"control": {"endpoint": f"ipc://{tmp_path}/c"}, "stream": {"endpoints": [f"ipc://{tmp_path}/s"]}}
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(data))
    return rig


def state_of(client: ControlClient) -> str:
    try:
        return str(client.call("status")["state"])
    except NoDaemonError:  # it starts
        return ""


def calibrate(step: str, rig: Path, *more: str) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-c",
        PROGRAM,
        "calibrate",
        step,
        str(rig),
        "--out",
        str(rig.parent / "calibration.yaml"),
        *more,
    ]
    process = subprocess.run(command, capture_output=True, text=True, timeout=350, check=False)
    assert process.returncode == 0, process.stderr
    return process


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    ("scale", "board", "poses"), [(*SMALL, 3), pytest.param(SCALE, BOARD, 4, marks=pytest.mark.long)]
)
def test_everything_is_calibrated_from_start_to_file(tmp_path: Path, scale: float, board: str, poses: int) -> None:
    process = calibrate("all", rig_file(tmp_path, poses=poses, scale=scale, board=board), "--board", board)
    found, truth = read_calibration(tmp_path / "calibration.yaml").calibration, RigLayout().scaled(scale).calibration()
    assert found.baseline_mm == pytest.approx(truth.baseline_mm, rel=5e-4)
    for device in ("left", "right", "projector"):
        ours, true = getattr(found, device), getattr(truth, device)
        assert ours.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=2e-3)
        assert np.abs(ours.matrix[:2, 2] - true.matrix[:2, 2]).max() < 1.5
    assert found.response is not None and found.left_color.crosstalk[0, 1] > 0.01
    (session,) = (tmp_path / "calibration-sessions").iterdir()
    assert sorted(path.name for path in session.iterdir()) == ["board", "color"]
    assert len(list((session / "board").glob("view_*"))) == poses
    assert "no daemon is running" in process.stderr and f"view {poses} of 12 accepted" in process.stderr


@pytest.mark.long  # tests/daemon/apps/calibration/guided has the captures of a daemon in the same process
@pytest.mark.timeout(400)
def test_a_running_daemon_captures_the_images_and_continues_measuring(tmp_path: Path) -> None:
    rig = rig_file(tmp_path, poses=3)
    with subprocess.Popen([sys.executable, "-c", DAEMON, str(rig)]) as daemon:
        try:
            with ControlClient(f"ipc://{tmp_path}/c", timeout_s=60.0) as client:
                wait_until(lambda: state_of(client) == "running", 60)
                process = calibrate("cameras", rig)
                wait_until(lambda: client.call("status")["state"] == "running")
                clouds = client.call("status")["clouds"]
                wait_until(lambda: client.call("status")["clouds"] > clouds)
        finally:
            daemon.terminate()
    assert daemon.returncode == 0
    assert "captured by the running daemon calibrate-sim" in process.stderr
    found = read_cameras(tmp_path / "calibration.yaml").cameras
    assert found.baseline_mm == pytest.approx(RigLayout().baseline_mm, rel=5e-4)
    assert not list(tmp_path.glob("capture*.mcap")), "temporary captures are removed"
