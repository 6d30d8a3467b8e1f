"""The command a user types, on a simulated rig with a simulated hand: from nothing to a calibration, unattended."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from daemon.calibration_file import read_calibration
from sim.rig import RigLayout

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "calibrate-sim.yaml"


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_everything_is_calibrated_from_start_to_file(tmp_path: Path) -> None:
    data = yaml.safe_load(EXAMPLE.read_text())
    data["simulation"] |= {"poses": 6, "rate_hz": 50.0}
    data |= {"control": {"endpoint": f"ipc://{tmp_path}/c"}, "stream": {"endpoints": [f"ipc://{tmp_path}/s"]}}
    rig, out = tmp_path / "rig.yaml", tmp_path / "calibration.yaml"
    rig.write_text(yaml.safe_dump(data))
    program = "from daemon.entry import main; main()"
    command = [sys.executable, "-c", program, "calibrate", "all", str(rig), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=350, check=False)
    assert done.returncode == 0, done.stderr
    found, truth = read_calibration(out).calibration, RigLayout().scaled(0.25).calibration()
    assert found.baseline_mm == pytest.approx(truth.baseline_mm, rel=5e-4)
    for device in ("left", "right", "projector"):
        ours, true = getattr(found, device), getattr(truth, device)
        assert ours.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=2e-3)
        assert np.abs(ours.matrix[:2, 2] - true.matrix[:2, 2]).max() < 1.5
    assert found.response is not None and found.left_color.crosstalk[0, 1] > 0.01
    (session,) = (tmp_path / "calibration-sessions").iterdir()
    assert sorted(path.name for path in session.iterdir()) == ["board", "color"]
    assert len(list((session / "board").glob("view_*"))) == 6
    assert "no daemon is running" in done.stderr and "view 6 of 12 is taken" in done.stderr
