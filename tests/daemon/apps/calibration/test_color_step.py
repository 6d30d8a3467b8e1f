"""The colour step writes the crosstalk and gamma of a drawn rig into its calibration."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from daemon.cli.command_table import invoke
from daemon.cli.entry import run
from daemon.rig.calibration_file import read_calibration
from pipeline.calibrate.color import color_sequence
from pipeline.calibrate.targets.board.board import Board
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.sequence import FrameSequence, projector_sequence
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel
from tests.daemon.apps.calibration import drawn
from tests.daemon.apps.calibration.conftest import BOARD

MIX = {
    "left": np.array([[1, 0.12, 0.03], [0.1, 1, 0.12], [0.02, 0.11, 1]]),
    "right": np.array([[1, 0.1, 0.02], [0.12, 1, 0.1], [0.03, 0.12, 1]]),
}
BLACK = np.array([3.0, 4.0, 5.0])
GAMMA = 2.2


def lit(device: CameraModel, projector: CameraModel) -> np.ndarray:
    """Projector pixel that lights each pixel of a camera on a white board 1 m away, (H, W, 2)."""
    rays = np.concatenate([device.rays(), np.ones((*device.size[::-1], 1))], axis=-1) @ device.rotation
    world = device.centre + ((1000 - device.centre[2]) / rays[..., 2])[..., None] * rays
    return projector.project(world.reshape(-1, 3)).reshape(*device.size[::-1], 2).astype(np.float32)


def write_session(folder: Path, rig: Cameras, sequence: FrameSequence) -> None:
    view = folder / "view_00"
    view.mkdir(parents=True)
    (folder / "capture.json").write_text(json.dumps({"encoding": "rgb8", "sequence": sequence.as_mapping()}))
    assert rig.projector is not None
    rng = np.random.default_rng(5)
    lights = [((np.ascontiguousarray(frame.image()) / 255.0) ** GAMMA).astype(np.float32) for frame in sequence.frames]
    for side, device in (("left", rig.left), ("right", rig.right)):
        at = lit(device, rig.projector)
        for n, light in enumerate(lights):
            received = cv2.remap(light, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
            counts = BLACK + cv2.transform(received, 175 * MIX[side])
            counts += 0.7 * rng.standard_normal(received.shape, np.float32)
            drawn.write_png(view / f"{side}_{n:02d}.png", np.clip(np.rint(counts), 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def color_folder(tmp_path_factory: pytest.TempPathFactory, true_rig: Cameras) -> Path:
    folder = tmp_path_factory.mktemp("color") / "session"
    check = ColorFringe(size=drawn.PROJECTOR, periods=15)
    write_session(folder, true_rig, color_sequence(drawn.PROJECTOR, levels=9, check=check))
    return folder


def test_colours_are_written_into_a_calibration(
    tmp_path: Path, color_folder: Path, truth_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_bytes(truth_file.read_bytes())
    assert invoke(["calibrate", "color", "--views", str(color_folder), "--calibration", str(path)]) == 0
    assert "crosstalk up to 12" in capsys.readouterr().err
    found, before = read_calibration(path).calibration, read_calibration(truth_file).calibration
    for side, color in (("left", found.left_color), ("right", found.right_color)):
        assert np.abs(color.crosstalk - MIX[side]).max() < 0.01
    assert found.response is not None
    levels = np.arange(32.0, 256, 32)
    light = found.response.light(np.repeat(levels[:, None], 3, 1)) / 255
    assert np.abs(light - (levels[:, None] / 255) ** GAMMA).max() < 0.02
    for side in ("left", "right", "projector"):
        np.testing.assert_array_equal(getattr(found, side).matrix, getattr(before, side).matrix)
    quality = yaml.safe_load(path.read_text())["quality"]["color"]
    # The fringes of this session were not pre-distorted: crosstalk alone is corrected.
    uncorrected, corrected = quality["left"]["phase_error_rad"]
    assert corrected < uncorrected
    assert len(list(tmp_path.glob("calibration.2*.yaml"))) == 1


def test_colours_need_a_calibrated_projector(
    tmp_path: Path, color_folder: Path, true_rig: Cameras, capsys: pytest.CaptureFixture[str]
) -> None:
    from daemon.apps.calibration.solve.archive import store

    path = tmp_path / "calibration.yaml"
    store(path, Cameras(true_rig.left, true_rig.right), quality={})
    before = path.read_bytes()
    assert run(["calibrate", "color", "--views", str(color_folder), "--calibration", str(path)]) == 2
    assert "projector is missing: run fringed calibrate projector" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_fringes_for_geometry_are_no_colours(
    tmp_path: Path, board: Board, true_rig: Cameras, truth_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, folder = tmp_path / "calibration.yaml", tmp_path / "fringes"
    path.write_bytes(truth_file.read_bytes())
    sequence = projector_sequence(drawn.PROJECTOR, steps=4)
    drawn.write_capture(folder, true_rig, board, drawn.poses(board, 1), sequence)
    assert run(["calibrate", "color", "--views", str(folder), "--calibration", str(path)]) == 2
    assert "no sequence of uniform colours" in capsys.readouterr().err


@pytest.mark.long
def test_everything_at_once(tmp_path: Path, capture_folder: Path, color_folder: Path) -> None:
    out = tmp_path / "calibration.yaml"
    views = ["--views", str(capture_folder), "--views", str(color_folder)]
    assert invoke(["calibrate", "all", *views, "--board", BOARD, "--out", str(out)]) == 0
    rig = read_calibration(out).calibration
    assert rig.response is not None
    assert np.abs(rig.left_color.crosstalk - MIX["left"]).max() < 0.01
    quality = yaml.safe_load(out.read_text())["quality"]
    assert {"rms_projector_px", "color"} <= quality.keys()


def test_all_needs_both_kinds_of_views(color_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert invoke(["calibrate", "all", "--views", str(color_folder), "--board", BOARD]) == 2
    assert "no --views for the board" in capsys.readouterr().err
