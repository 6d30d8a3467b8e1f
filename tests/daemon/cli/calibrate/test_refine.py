"""A drift is corrected from ordinary pairs, validated by others, and written only after confirmation."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import typer
import yaml
from typer.testing import CliRunner

from benchmarks.calibration.selfcheck import Rig
from daemon.apps.calibration.views import drift_pairs
from daemon.apps.calibration.views.drift_pairs import from_take
from daemon.cli.calibrate import refine as calibrate_refine
from daemon.rig.calibration_file import calibration_bytes, parse_calibration, read_calibration
from pipeline.calibrate.drift_correction import Pair, refine, table
from pipeline.common.errors import CalibrationError
from pipeline.monitor.explain import rotated
from sim.rig.disturbance import Disturbance
from tests.golden.make import TAKE

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
SCALE = 0.25


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(SCALE, instants=2)


def pairs(rig: Rig, *disturbances: Disturbance) -> list[Pair]:
    scene = rig.scene(*disturbances)
    return [scene.pair(index) for index in islice(range(100), 4)]  # type: ignore[misc]


def test_a_rotated_right_camera_is_identified_and_corrected(rig: Rig) -> None:
    captured = pairs(rig, Disturbance("right", turn_deg=(0.02, 0.03, -0.02)))
    found = refine(rig.calibration, rig.pattern, rig.volume, "rgb8", captured)
    assert found.device == "right" and found.better
    assert np.array(found.turn_deg) == pytest.approx([0.02, 0.03, -0.02], abs=0.006)
    for name in ("column_px", "column_x_px", "column_y_px"):
        assert abs(found.after[name].value) < 0.01 < 0.04 + abs(found.before[name].value)
    assert abs(found.after["epipolar_px"].value) < 0.1 < abs(found.before["epipolar_px"].value)
    text = "\n".join(table(found))
    assert "before" in text and "trinocular residual" in text and "right turned" in text


@pytest.mark.long
def test_a_rotated_projector_is_refined(rig: Rig) -> None:
    captured = pairs(rig, Disturbance("projector", turn_deg=(0.0, 0.02, 0.0)))
    found = refine(rig.calibration, rig.pattern, rig.volume, "rgb8", captured, device="projector")
    assert found.better and abs(found.after["column_px"].value) < 0.02 < abs(found.before["column_px"].value)


def test_a_fitting_calibration_and_unusable_images_are_rejected(rig: Rig) -> None:
    captured = pairs(rig)
    with pytest.raises(CalibrationError, match="nothing to correct"):
        refine(rig.calibration, rig.pattern, rig.volume, "rgb8", captured)
    with pytest.raises(CalibrationError, match="at least 2"):
        refine(rig.calibration, rig.pattern, rig.volume, "rgb8", captured[:1])
    empty = [tuple(np.full_like(image, 40) for image in pair) for pair in captured]
    with pytest.raises(CalibrationError, match="smooth patches"):
        refine(rig.calibration, rig.pattern, rig.volume, "rgb8", empty)  # type: ignore[arg-type]


def test_a_drift_that_several_devices_explain_requires_the_device(rig: Rig) -> None:
    captured = pairs(rig, Disturbance("right", turn_deg=(0.03, 0.0, 0.0)))
    with pytest.raises(CalibrationError, match="--device"):
        refine(rig.calibration, rig.pattern, rig.volume, "rgb8", captured)


def test_the_command_confirms_before_it_writes(rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drift_pairs, "MOST_PAIRS", 4)
    options = {"live": True, "scene": "moving", "frames": 2, "layout": {"scale": SCALE}, "rate_hz": 30.0}
    off = rotated(rig.calibration, "right", (0.0, -0.03, 0.0))
    file = tmp_path / "calibration.yaml"
    file.write_bytes(calibration_bytes(off, quality={"rms_stereo_px": 0.05}))
    before = file.read_bytes()
    (tmp_path / "rig.yaml").write_text(
        yaml.safe_dump({"cameras": {"driver": "sim"}, "simulation": options, "calibration": "calibration.yaml"})
    )
    command = typer.Typer(add_completion=False)
    command.command()(calibrate_refine.main)
    arguments = [str(tmp_path / "rig.yaml"), "--calibration", str(file), "--device", "right"]
    rejected = CliRunner().invoke(command, arguments, input="n\n")
    assert rejected.exit_code == 1 and "nothing was written" in rejected.output, rejected.output
    assert file.read_bytes() == before
    accepted = CliRunner().invoke(command, [*arguments, "--yes"])
    assert accepted.exit_code == 0, accepted.output
    written = read_calibration(file)
    assert written.mapping["quality"]["refined"]["from"] == parse_calibration(before, "before").identity
    assert written.mapping["quality"]["rms_stereo_px"] == 0.05
    axis = written.calibration.right.rotation @ rig.calibration.right.rotation.T
    assert np.rad2deg(np.abs(axis - np.eye(3)).max()) < 0.01
    assert len(list(tmp_path.glob("calibration.2*.yaml"))) == 1


def test_pairs_are_spread_over_a_take(monkeypatch: pytest.MonkeyPatch) -> None:
    progress: list[tuple[int, int]] = []
    drift = from_take(TAKE, lambda *position: progress.append(position))
    assert (
        drift.pairs and drift.pairs[0][0].dtype == np.uint8 and drift.encoding in ("rgb8", "bayer_rggb8") and progress
    )
    monkeypatch.setattr(drift_pairs, "MOST_PAIRS", 1)
    assert len(from_take(TAKE, lambda *_: None).pairs) <= 2
