"""Exported and imported rigs are equal, and terms that a format lacks are reported."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.exchange import FORMATS, read_foreign, write_foreign
from daemon.cli.command_table import invoke
from daemon.rig.calibration_file import write_calibration
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel
from tests.daemon.apps.calibration.rigs import cameras, complete

SEEDS = range(6)


def round_trip(folder: Path, rig: Cameras, form: str) -> tuple[Cameras, list[str]]:
    files, notes = write_foreign(rig, form)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    found = read_foreign([folder / name for name in sorted(files)])
    assert found.form == form
    return found.cameras, notes


def same(device: CameraModel, other: CameraModel, *, atol: float = 1e-9) -> None:
    assert device.size == other.size
    for key in ("matrix", "distortion", "rotation"):
        np.testing.assert_allclose(getattr(device, key), getattr(other, key), atol=atol, rtol=1e-12)
    np.testing.assert_allclose(device.translation, other.translation, atol=1e3 * atol)


@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("form", FORMATS)
def test_an_exported_rig_is_imported_unchanged(tmp_path: Path, form: str, seed: int, vertical: bool) -> None:
    rig = cameras(seed, k3=form != "kalibr", vertical=vertical)
    back, notes = round_trip(tmp_path, rig, form)
    same(rig.left, back.left)
    same(rig.right, back.right)
    assert notes == []


@pytest.mark.parametrize("form", FORMATS)
def test_the_reported_error_of_an_omitted_skew_is_true(tmp_path: Path, form: str) -> None:
    rig = cameras(3, skew=True)
    back, notes = round_trip(tmp_path, rig, form)
    assert [note.split(":")[0] for note in notes] == ["left", "right"]
    for device, other, note in zip((rig.left, rig.right), (back.left, back.right), notes, strict=True):
        reported = float(note.split()[-2])
        points = np.concatenate([device.rays(), np.ones((*device.size[::-1], 1))], axis=-1)[::7, ::7]
        world = (1000 * points - device.translation) @ device.rotation
        away = np.linalg.norm(device.project(world) - other.project(world), axis=-1).max()
        assert away == pytest.approx(reported, abs=0.01 + 0.02 * reported)


def test_the_projector_is_exported_to_opencv(tmp_path: Path) -> None:
    rig = complete()
    full = Cameras(rig.left, rig.right, projector=rig.projector)
    back, _ = round_trip(tmp_path, full, "opencv")
    assert back.projector is not None
    same(rig.projector, back.projector)


def test_opencv_projects_with_the_exported_numbers_as_we_do(tmp_path: Path) -> None:
    rig = cameras(1)
    files, _ = write_foreign(rig, "opencv")
    (tmp_path / "s.yml").write_bytes(files["stereo.yml"])
    storage = cv2.FileStorage(str(tmp_path / "s.yml"), cv2.FILE_STORAGE_READ)
    m, d, r, t = (storage.getNode(key).mat() for key in ("M2", "D2", "R", "T"))
    storage.release()
    world = np.random.default_rng(0).uniform((-200, -200, 1100), (200, 200, 1500), (50, 3))
    pixels = cv2.projectPoints(world, cv2.Rodrigues(r)[0], t, m, d)[0][:, 0]
    np.testing.assert_allclose(pixels, rig.right.project(world), atol=1e-7)


def test_rectified_rows_agree_in_the_exported_ros_files() -> None:
    rig = cameras(2)
    files, _ = write_foreign(rig, "ros")
    import yaml

    infos = [yaml.safe_load(files[name]) for name in ("left.yaml", "right.yaml")]
    world = np.random.default_rng(1).uniform((-150, -150, 1150), (150, 150, 1450), (50, 3))
    rows, columns = [], []
    for device, info in zip((rig.left, rig.right), infos, strict=True):
        ideal = device.normalise(device.project(world))
        turn = np.reshape(info["rectification_matrix"]["data"], (3, 3))
        p = np.reshape(info["projection_matrix"]["data"], (3, 4))
        rectified = np.column_stack([ideal, np.ones(len(ideal))]) @ turn.T
        pixels = rectified @ p[:, :3].T
        rows.append(pixels[:, 1] / pixels[:, 2])
        columns.append(pixels[:, 0] / pixels[:, 2])
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-6)
    p = np.reshape(infos[1]["projection_matrix"]["data"], (3, 4))
    assert -p[0, 3] / p[0, 0] * 1000 == pytest.approx(rig.baseline_mm, rel=1e-9)
    assert (columns[0] > columns[1]).all()


def test_the_two_files_of_opencvs_sample_are_read_together_and_require_the_size(tmp_path: Path) -> None:
    rig = cameras(4)
    numbers = {"M1": rig.left.matrix, "D1": rig.left.distortion, "M2": rig.right.matrix, "D2": rig.right.distortion}
    for name, keys in (("intrinsics.yml", numbers), ("extrinsics.yml", {"R": rig.right.rotation, "T": None})):
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for key, value in keys.items():
            storage.write(key, rig.right.translation / 25 if value is None else value)
        storage.release()
    paths = [tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml"]
    with pytest.raises(SourceError, match="give --size WIDTHxHEIGHT"):
        read_foreign(paths)
    found = read_foreign(paths, size=(1024, 820), unit_mm=25).cameras
    same(found.left, rig.left)
    same(found.right, rig.right)


@pytest.mark.parametrize(
    ("form", "old", "new", "message"),
    [
        ("kalibr", "model: radtan", "model: equidistant", "cam0: distortion_model is 'equidistant', only radtan"),
        ("kalibr", "camera_model: pinhole", "camera_model: omni", "cam0: camera_model is 'omni'"),
        ("kalibr", "cam1:", "cam7:", "cam1 is missing"),
        ("kalibr", "resolution:", "solution:", "cam0: resolution is missing"),
        ("ros", "plumb_bob", "rational_polynomial", "distortion_model is 'rational_polynomial'"),
        ("ros", "image_width:", "imagewidth:", "image_width is missing"),
        ("opencv", "M2:", "MM:", "M2 is missing"),
        ("opencv", "\nT:", "\nTT:", "T is missing"),
        ("opencv", "data:", "dat:", ""),
    ],
)
def test_an_unusable_file_is_rejected_with_its_name_and_key(
    tmp_path: Path, form: str, old: str, new: str, message: str
) -> None:
    files, _ = write_foreign(cameras(0, k3=False), form)
    for name, data in files.items():
        (tmp_path / name).write_bytes(data.replace(old.encode(), new.encode()))
    with pytest.raises(SourceError) as error:
        read_foreign([tmp_path / name for name in sorted(files)], form=form)
    assert message in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_ros_files_in_the_wrong_order_are_rejected(tmp_path: Path) -> None:
    files, _ = write_foreign(cameras(0), "ros")
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    with pytest.raises(SourceError, match="this is the right camera's file"):
        read_foreign([tmp_path / "right.yaml", tmp_path / "left.yaml"])


def test_the_commands_export_and_import(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = complete()
    write_calibration(tmp_path / "calibration.yaml", rig)
    out = str(tmp_path / "ros")
    assert invoke(["calibrate", "export", str(tmp_path / "calibration.yaml"), "--format", "ros", "--out", out]) == 0
    back = tmp_path / "back.yaml"
    assert invoke(["calibrate", "import", f"{out}/left.yaml", f"{out}/right.yaml", "--out", str(back)]) == 0
    assert f"baseline {rig.baseline_mm:.2f} mm" in capsys.readouterr().out
    from daemon.rig.calibration_file import read_cameras

    assert read_cameras(back).cameras.projector is None
