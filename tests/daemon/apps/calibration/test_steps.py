"""The commands on images write the calibration of the true rig and a well-formed report."""

from __future__ import annotations

import io
import json
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
import yaml

from daemon.cli.command_table import invoke
from daemon.rig.calibration_file import read_calibration, read_cameras
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel
from tests.daemon.apps.calibration.conftest import BOARD

NAMES = ("rms_left_px", "rms_right_px", "rms_stereo_px", "epipolar_px", "views_used", "views_rejected")


def cameras_command(folder: Path, *more: str) -> list[str]:
    left, right = str(folder / "L" / "*.png"), str(folder / "R" / "*.png")
    return ["calibrate", "cameras", "--left", left, "--right", right, "--board", BOARD, *more]


def field_error_px(found: CameraModel, true: CameraModel, *, near: float = 900, far: float = 1100) -> float:
    """Largest difference of the projections of points in the middle of the image."""
    v, u = np.mgrid[0.15:0.85:9j, 0.15:0.85:9j]
    pixels = np.stack([u * true.size[0], v * true.size[1]], axis=-1)
    rays = np.concatenate([true.normalise(pixels), np.ones((9, 9, 1))], axis=-1)
    errors = []
    for depth in (near, far):
        world = (depth * rays - true.translation) @ true.rotation
        errors.append(np.linalg.norm(found.project(world) - true.project(world), axis=-1).max())
    return float(max(errors))


def check_report(path: Path, *expected: str) -> None:
    text = path.read_text(encoding="utf-8")
    root = ET.fromstring(text.removeprefix("<!DOCTYPE html>"))
    content = " ".join(root.itertext())
    for text_part in expected:
        assert text_part in content, text_part
    assert "<script" not in text
    links = re.findall(r'(?:href|src)="([^"]*)"', text)
    assert links
    assert all(link.startswith("data:image/jpeg;base64,") for link in links)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory, session_folder: Path) -> tuple[Path, str]:
    """A folder with the results of the command on the session, and what it printed."""
    folder, output = tmp_path_factory.mktemp("calibrated"), io.StringIO()
    out, report = folder / "calibration.yaml", folder / "report.html"
    with redirect_stdout(output):
        assert invoke(cameras_command(session_folder, "--out", str(out), "--report", str(report))) == 0
    return folder, output.getvalue()


def test_cameras_are_calibrated_with_the_command_of_the_manual(
    calibrated: tuple[Path, str], session_folder: Path, true_rig: Cameras
) -> None:
    folder, output = calibrated
    assert "10 views used, 0 left out" in output
    file = read_cameras(folder / "calibration.yaml")
    quality = file.mapping["quality"]
    assert all(name in quality for name in NAMES)
    assert quality["views_used"] == 10
    assert quality["report"] == "report.html"
    assert quality["board"] == BOARD
    sigma = quality["standard_deviations"]
    for side, found, true in (
        ("left", file.cameras.left, true_rig.left),
        ("right", file.cameras.right, true_rig.right),
    ):
        assert quality[f"rms_{side}_px"] < 0.05
        assert abs(found.matrix[0, 0] - true.matrix[0, 0]) < 5 * sigma[f"{side}.fx"] + 0.05
    # Both cameras together, relative to the left one: the error that affects a measurement.
    assert abs(file.cameras.baseline_mm - true_rig.baseline_mm) < 5 * sigma["baseline_mm"]
    assert quality["epipolar_px"] < 0.05
    parts = "Coverage", "Residuals", "translation_x", "std. dev.", "Errors by view", "00, left"
    check_report(folder / "report.html", *parts)
    assert sorted(path.name for path in folder.iterdir()) == ["calibration.yaml", "report.html"]
    assert sorted(path.name for path in session_folder.iterdir()) == ["L", "R"]


def test_a_second_calibration_keeps_the_first_one_and_compares_with_it(
    tmp_path: Path, calibrated: tuple[Path, str], session_folder: Path
) -> None:
    out = tmp_path / "calibration.yaml"
    shutil.copy(calibrated[0] / "calibration.yaml", out)
    first = out.read_bytes()
    assert invoke(cameras_command(session_folder, "--out", str(out))) == 0
    kept = list(tmp_path.glob("calibration.2*.yaml"))
    assert [path.read_bytes() for path in kept] == [first]
    check_report(tmp_path / "calibration.report.html", "Before: 2", "in std. dev.")


def test_projector_and_cameras_are_solved_together(
    images: Path, capture_folder: Path, true_rig: Cameras, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in images.glob("[LR]/0[5-9].png"):
        path.unlink()
    out = images / "calibration.yaml"
    command = cameras_command(images, "--views", str(capture_folder), "--out", str(out))
    command[1] = "projector"
    assert invoke(command) == 0
    assert "projector 0.0" in capsys.readouterr().out
    rig = read_calibration(out).calibration
    quality = yaml.safe_load(out.read_text())["quality"]
    assert quality["rms_projector_px"] < 0.05
    assert quality["views_used"] == 9
    assert 0 <= quality["order_merit"] <= 1
    assert quality["trinocular_px"] < 0.05
    true = true_rig.complete()
    # A common rotation relative to the left camera has no effect on measurements; pixels show the difference.
    for device, expected in ((rig.right, true.right), (rig.projector, true.projector)):
        assert field_error_px(device, expected) < 1.0
    assert rig.baseline_mm == pytest.approx(true.baseline_mm, rel=5e-4)
    check_report(out.with_name("calibration.report.html"), "coverage, projector")


def test_cameras_are_calibrated_from_the_white_frames_of_a_capture(
    tmp_path: Path, capture_folder: Path, true_rig: Cameras, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "calibration.yaml"
    command = ["calibrate", "cameras", "--views", str(capture_folder), "--board", BOARD, "--out", str(out)]
    monkeypatch.setattr("daemon.apps.calibration.report.report.MOST_IMAGES", 4)
    assert invoke(command) == 0
    page = (tmp_path / "calibration.report.html").read_text()
    assert page.count("<image") == 4
    assert "The worst views are shown, 4 images are omitted." in page
    file = read_cameras(out)
    assert file.cameras.projector is None
    assert file.cameras.baseline_mm == pytest.approx(true_rig.baseline_mm, rel=1e-3)


def test_a_distance_on_the_board_sets_the_scale(tmp_path: Path, capture_folder: Path, true_rig: Cameras) -> None:
    out = tmp_path / "calibration.yaml"
    command = ["calibrate", "cameras", "--views", str(capture_folder), "--board", BOARD, "--out", str(out)]
    # The marks 0 and 62 are sqrt(8^2 + 6^2) = 10 pitches of 24 mm apart; the given distance is one per cent more.
    assert invoke([*command, "--distance", "0-62:242.4"]) == 0
    assert read_cameras(out).cameras.baseline_mm == pytest.approx(1.01 * true_rig.baseline_mm, rel=1e-3)
    assert invoke([*command, "--distance", "0:62:242.4"]) == 2


@pytest.mark.shared
def test_the_real_chessboard_pairs_are_calibrated(tmp_path: Path, shared_data: Callable[..., Path]) -> None:
    folder = shared_data("chessboard_stereo")
    out = tmp_path / "calibration.yaml"
    pairs = ["--left", str(folder / "left0[1-5].jpg"), "--right", str(folder / "right0[1-5].jpg")]
    assert invoke(["calibrate", "cameras", *pairs, "--board", "chessboard:9x6:25", "--out", str(out)]) == 0
    quality = read_cameras(out).mapping["quality"]
    assert quality["views_used"] + quality["views_rejected"] == 5
    assert quality["views_used"] >= 4
    assert quality["rms_stereo_px"] < 0.25
    check_report(tmp_path / "calibration.report.html", "left01", "baseline")


def test_the_calibration_measures_the_true_distances(
    calibrated: tuple[Path, str], session_folder: Path, capsys: pytest.CaptureFixture[str], truth_file: Path
) -> None:
    view = [
        "--left",
        str(session_folder / "L" / "04.png"),
        "--right",
        str(session_folder / "R" / "04.png"),
        "--board",
        BOARD,
        "--json",
    ]
    for file in (calibrated[0] / "calibration.yaml", truth_file):
        assert invoke(["calibrate", "check", "--calibration", str(file), *view]) == 0
        (found,) = json.loads(capsys.readouterr().out)
        assert found["marks"] == 63
        assert found["pairs"] == 63 * 62 // 2
        assert abs(found["scale_ppm"]) < 150
        assert found["rms_mm"] < 0.03
        assert found["epipolar_px"] < 0.05


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"baseline": 1.002}, "ppm too long"),
        ({"turn": 0.002}, "from their epipolar lines"),
        ({"focal": 1.01}, "is wrong by|ppm too|epipolar"),
    ],
)
def test_a_changed_rig_is_detected(
    tmp_path: Path, session_folder: Path, truth_file: Path, capsys: pytest.CaptureFixture[str],
    change: dict[str, float], complaint: str,
) -> None:  # fmt: skip
    mapping = yaml.safe_load(truth_file.read_text())
    right = mapping["cameras"]["right"]
    if "baseline" in change:
        right["translation"] = [change["baseline"] * x for x in right["translation"]]
    if "turn" in change:
        c, s = np.cos(change["turn"]), np.sin(change["turn"])
        turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        right["rotation"] = (turn @ right["rotation"]).tolist()
        right["translation"] = (turn @ right["translation"]).tolist()
    if "focal" in change:
        right["matrix"][0][0] *= change["focal"]
        right["matrix"][1][1] *= change["focal"]
    path = tmp_path / "calibration.yaml"
    path.write_text(yaml.safe_dump(mapping))
    view = ["--left", str(session_folder / "L" / "00.png"), "--right", str(session_folder / "R" / "00.png")]
    assert invoke(["calibrate", "check", "--calibration", str(path), *view, "--board", BOARD]) == 1
    output = capsys.readouterr()
    assert "OUT" in output.out
    assert re.search(complaint, output.err)


def test_usage_errors_are_reported(images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert invoke(["calibrate", "cameras", "--left", str(images / "L" / "*.png"), "--board", BOARD]) == 2
    assert "--left and --right belong together" in capsys.readouterr().err
    assert invoke(["calibrate", "cameras", "--board", BOARD]) == 2
    assert "give a rig.yaml to calibrate live, or images" in capsys.readouterr().err
