"""The old calibration is never lost, and a better one is replaced only by force."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
import yaml

from daemon.apps.calibration.errors import KeptError
from daemon.apps.calibration.solve.archive import store
from daemon.apps.calibration.solve.keep_colors import with_old_colors
from daemon.rig.calibration_file import read_calibration, read_cameras, write_calibration
from pipeline.common.errors import CalibrationError
from tests.daemon.apps.calibration.rigs import cameras, complete

GOOD = {"rms_stereo_px": 0.05, "epipolar_px": 0.04, "coverage_left": 0.8, "coverage_right": 0.8}
NOON = datetime(2026, 11, 21, 12, 0, 0, tzinfo=UTC)
LATER = datetime(2026, 11, 22, 8, 30, 0, tzinfo=UTC)


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"rms_stereo_px": 0.07}, "the marks' reprojection error would grow from 0.050 to 0.070 px"),
        ({"epipolar_px": 0.06}, "the epipolar error would grow from 0.040 to 0.060 px"),
        ({"coverage_right": 0.5}, "the marks would cover 50 % instead of 80 % of the right image"),
        ({"rms_stereo_px": None}, "its errors are known, those of the new one are not"),
    ],
)
def test_a_better_calibration_is_replaced_only_by_force(tmp_path: Path, changes: dict[str, float], reason: str) -> None:
    path = tmp_path / "calibration.yaml"
    store(path, cameras(0), quality=GOOD, created=NOON)
    before = files(tmp_path)
    with pytest.raises(KeptError) as error:
        store(path, cameras(1), quality=GOOD | changes, created=LATER)
    assert reason in str(error.value)
    assert files(tmp_path) == before
    stored = store(path, cameras(1), quality=GOOD | changes, created=LATER, force=True)
    assert reason in stored.notes[0]
    assert files(tmp_path)["calibration.2026-11-21T120000Z.yaml"] == before["calibration.yaml"]


@pytest.mark.parametrize("changes", [{}, {"rms_stereo_px": 0.0545}, {"rms_stereo_px": 0.02, "coverage_left": 0.75}])
def test_one_as_good_or_better_replaces_it_and_the_old_one_is_kept(tmp_path: Path, changes: dict[str, float]) -> None:
    path = tmp_path / "calibration.yaml"
    first = store(path, cameras(0), quality=GOOD, created=NOON)
    assert first.kept is None
    old = path.read_bytes()
    second = store(path, cameras(1), quality=GOOD | changes, created=LATER)
    assert second.kept == tmp_path / "calibration.2026-11-21T120000Z.yaml"
    assert second.kept.read_bytes() == old
    assert read_cameras(path).identity == second.identity


def test_two_of_the_same_second_are_both_kept(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    for seed in range(4):
        store(path, cameras(seed), quality=GOOD, created=NOON)
    assert sorted(files(tmp_path)) == [
        "calibration.2026-11-21T120000Z-2.yaml",
        "calibration.2026-11-21T120000Z-3.yaml",
        "calibration.2026-11-21T120000Z.yaml",
        "calibration.yaml",
    ]


def test_a_complete_calibration_is_not_replaced_by_cameras_alone_unless_forced(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    write_calibration(path, complete(), created=NOON)
    with pytest.raises(KeptError, match="it has a projector, the new one has none"):
        store(path, cameras(0), quality=GOOD)
    store(path, cameras(0), quality=GOOD, force=True)
    assert read_cameras(path).cameras.projector is None
    with pytest.raises(CalibrationError, match="projector is missing: run fringed calibrate projector"):
        read_calibration(path)


def test_unknown_keys_are_carried_over(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    store(path, cameras(0), quality=GOOD, created=NOON)
    mapping = yaml.safe_load(path.read_text())
    mapping["owner"] = "the laboratory"
    mapping["cameras"]["right"]["serial"] = "22"
    path.write_text(yaml.safe_dump(mapping))
    store(path, cameras(1), quality=GOOD, created=LATER)
    after = yaml.safe_load(path.read_text())
    assert after["owner"] == "the laboratory"
    assert after["cameras"]["right"]["serial"] == "22"
    assert after["created"] == "2026-11-22T08:30:00Z"


def test_a_file_that_is_no_calibration_is_replaced_only_by_force(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text("shopping: [milk]\n")
    with pytest.raises(CalibrationError, match="the file is unchanged"):
        store(path, cameras(0), quality=GOOD)
    assert path.read_text() == "shopping: [milk]\n"
    stored = store(path, cameras(0), quality=GOOD, force=True)
    assert stored.kept is not None
    assert stored.kept.read_text() == "shopping: [milk]\n"


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "calibration.yaml"
    store(path, cameras(0), quality=GOOD, created=NOON)
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("daemon.apps.calibration.solve.archive.write_atomically", full)
    with pytest.raises(OSError, match="No space left"):
        store(path, cameras(1), quality=GOOD, created=LATER)
    assert path.read_bytes() == before


def test_colours_are_kept_with_new_cameras_and_the_projector_is_not(tmp_path: Path) -> None:
    write_calibration(tmp_path / "old.yaml", complete())
    old = read_cameras(tmp_path / "old.yaml")
    merged, notes = with_old_colors(cameras(5), old)
    assert merged.left_color.crosstalk.tolist() == old.cameras.left_color.crosstalk.tolist()
    assert merged.projector is None
    assert any("the colours of the old file are kept" in note for note in notes)
    assert any("run fringed calibrate projector" in note for note in notes)
