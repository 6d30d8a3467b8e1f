"""The commands ``info``, ``check`` and ``export``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes, cloud_name
from daemon.cli.entry import run
from daemon.recording.read.inspect import gaps, inspect, unwrapped
from daemon.recording.read.take_reader import TakeReader
from tests.daemon.recording import small_take
from tests.daemon.recording.takes import pair, unpaired, write

PATTERN = {
    "kind": "color_fringe",
    "size": [1280, 1024],
    "periods": 96,
    "axis": "x",
    "mean": 127.5,
    "amplitude": 118.0,
    "shifts": {"red": -2.1, "green": 0.0, "blue": 2.1},
}
GOOD = {"pattern": PATTERN}


def report_of(path: Path) -> dict[str, object]:
    with TakeReader(path) as take:
        return inspect(take)


def test_the_report_counts_pairs_unpaired_and_duplicate_frames_and_gaps(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(1), pair(2), pair(2), unpaired("left", 4), pair(9)], **GOOD)
    report = report_of(path)
    assert report["whole"]
    assert (report["pairs"], report["frames"]) == (3, {"left": 5, "right": 4})
    assert report["unpaired"] == {"left": 1, "right": 0}
    assert report["duplicates"] == {"left": 1, "right": 1}
    assert (report["first_sequence"], report["last_sequence"]) == (1, 9)
    assert (report["missing"], report["gaps"]) == (5, [[3, 3], [5, 8]])
    assert report["duration_s"] == pytest.approx(8 * 0.033)


def test_numbers_that_wrap_leave_no_gap(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(n % 2**32) for n in range(2**32 - 2, 2**32 + 2)], **GOOD)
    report = report_of(path)
    assert (report["first_sequence"], report["last_sequence"], report["missing"]) == (2**32 - 2, 1, 0)


def test_unwrapping_chooses_the_nearest_number() -> None:
    rng = np.random.default_rng(3)
    true = 5
    last: int | None = None
    for step in rng.integers(-5, 2**31 - 1, 200):
        true += int(step)
        last = unwrapped(true % 2**32, last)
        assert (last - 5) % 2**32 == (true - 5) % 2**32
        assert last == true
    assert gaps({1, 2, 5, 6, 9}) == [(3, 4), (7, 8)]


def test_all_parts_are_one_take(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(n) for n in range(6)], max_part_bytes=12_000, **GOOD)
    report = report_of(path)
    assert len(list(tmp_path.iterdir())) > 1
    assert len(report["parts"]) == len(list(tmp_path.iterdir()))  # type: ignore[arg-type]
    assert (report["pairs"], report["missing"], report["whole"]) == (6, 0, True)


def test_info_of_a_truncated_take_reports_the_position_and_exits_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(n) for n in range(4)], **GOOD)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert run(["info", "--json", str(path)]) == 1
    report = json.loads(capsys.readouterr().out)
    assert not report["whole"]
    assert 0 < report["truncated_at"] <= len(whole) // 2
    assert 1 <= report["pairs"] < 4
    assert "cut off" in report["problems"][0]
    assert run(["info", str(path)]) == 1
    assert "cut off" in capsys.readouterr().out


def test_check_names_file_and_position_of_every_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = {
        "calibration.yaml": ("fringed_calibration: 1\ncameras: 3\n", "calibration.yaml:2:1: cameras"),
        "pattern.json": ('{"kind": "color_fringe",\n "kind": 1}', "pattern.json"),
        "volume.json": ('{"near_mm": 5, "far_mm": 4}', "volume.json"),
        "rig.yaml": ("cameras: {driver: simm}\n", "rig.yaml:1:"),
        "take.mcap": ("not at all", "take.mcap"),
    }
    for name, (text, _) in bad.items():
        (tmp_path / name).write_text(text)
    assert run(["check", *(str(tmp_path / name) for name in bad), str(tmp_path / "absent.yaml")]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    for _, expected in bad.values():
        assert expected in shown.err
    assert "absent.yaml: No such file" in shown.err


def test_check_of_a_take_reports_an_unusable_attachment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(0)], **GOOD)  # its calibration is a stub
    assert run(["check", str(path)]) == 1
    assert "calibration.yaml" in capsys.readouterr().err


def write_clouds(directory: Path, count: int) -> None:
    directory.mkdir()
    for i in range(count):
        xyz = np.full((8, 10, 3), 1300 + 10 * i, np.float32)
        xyz[i] = np.nan
        cloud = SavedCloud(xyz, np.ones((8, 10), np.float32), np.full((8, 10), 9, np.uint8))
        (directory / cloud_name(i, "npz")).write_bytes(cloud_bytes(cloud, "npz"))


def test_export_writes_a_file_for_every_cloud(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_clouds(tmp_path / "clouds", 3)
    for kind in ("ply", "pcd"):
        assert run(["export", str(tmp_path / "clouds"), "--out", str(tmp_path / kind), "--format", kind]) == 0
        assert sorted(p.name for p in (tmp_path / kind).iterdir()) == [f"cloud_{i:06d}.{kind}" for i in range(3)]
    assert run(["export", str(tmp_path / "clouds"), "--out", str(tmp_path / "depth.avi")]) == 0
    assert "3 images" in capsys.readouterr().out


def test_export_rejects_invalid_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_clouds(tmp_path / "clouds", 1)
    base = ["export", str(tmp_path / "clouds"), "--out"]
    for extra, message in (
        ([str(tmp_path / "x"), "--format", "obj"], "expected one of: npz, ply, pcd"),
        ([str(tmp_path / "x"), "--set", "min_modulation=7"], "require a take"),
        ([str(tmp_path / "x.mp4"), "--near", "9", "--far", "8"], "smaller"),
    ):
        assert run(base + extra) == 2
        assert message in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert run(["export", str(tmp_path / "empty"), "--out", str(tmp_path / "x")]) == 2
    assert "no clouds (*.npz) and no takes (*.mcap)" in capsys.readouterr().err


def test_a_snapshot_and_a_single_cloud_are_exported_under_their_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_clouds(tmp_path / "clouds", 2)
    (tmp_path / "clouds" / "cloud_000001.npz").rename(tmp_path / "clouds" / "face_000815.npz")
    for name in ("cloud_000000", "face_000815"):
        assert run(["export", str(tmp_path / "clouds" / f"{name}.npz"), "--out", str(tmp_path / name)]) == 0
        assert [path.name for path in (tmp_path / name).iterdir()] == [f"{name}.ply"]
    assert capsys.readouterr().out == f"1 cloud in {tmp_path / 'cloud_000000'}\n1 cloud in {tmp_path / 'face_000815'}\n"
    assert run(["export", str(tmp_path / "clouds"), "--out", str(tmp_path / "all")]) == 0
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == ["cloud_000000.ply", "face_000815.ply"]


def test_every_take_of_a_directory_is_exported_into_its_own_and_clouds_beside_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_clouds(tmp_path / "in", 1)
    images = small_take.render()
    for name in ("a", "b"):
        small_take.write(tmp_path / "in" / f"{name}.mcap", images[:1], session=name)
    (tmp_path / "in" / "c.mcap").write_text("not at all")
    assert run(["export", str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    assert "left out: c.mcap: " in capsys.readouterr().err
    files = sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.ply"))
    assert files == ["a/cloud_000040.ply", "b/cloud_000040.ply", "cloud_000000.ply"]
    assert run(["export", str(tmp_path / "in"), "--out", str(tmp_path / "video.mp4")]) == 2
    assert "clouds, a.mcap, b.mcap; a video shows one of them" in capsys.readouterr().err


@pytest.mark.shared
def test_the_foreign_take_is_complete(shared_data: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    path = shared_data("bust", "take.mcap")
    report = report_of(path)
    assert (report["pairs"], report["missing"], report["problems"]) == (1, 0, [])
    names = ("take.mcap", "calibration.yaml", "pattern.json", "volume.json")
    assert run(["check", *(str(shared_data("bust", name)) for name in names)]) == 0
    assert capsys.readouterr().out.count(": good") == 4


def test_an_unreadable_part_does_not_affect_the_others(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(n) for n in range(6)], max_part_bytes=12_000, **GOOD)
    before = report_of(path)
    last = sorted(tmp_path.glob("take_part*.mcap"))[-1]
    last.write_bytes(b"")  # as a power cut leaves it
    report = report_of(path)
    assert report["pairs"] > 0  # type: ignore[operator]
    assert report["pairs"] < before["pairs"]  # type: ignore[operator]
    assert not report["whole"]
    assert any(last.name in problem for problem in report["problems"])  # type: ignore[attr-defined]


def test_parts_of_another_take_are_left_out(tmp_path: Path) -> None:
    write(tmp_path / "take.mcap", [pair(0)], **GOOD)
    write(tmp_path / "take_part002.mcap", [pair(1)], session="another", **GOOD)
    assert report_of(tmp_path / "take.mcap")["pairs"] == 1
