"""``fringed replay`` on a small take of the simulated rig."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from daemon.apps.export.cloud_files import read_cloud
from daemon.cli.takes.replay import INCONSISTENT
from pipeline.monitor.check.consistency import ConsistencyCheck, judged
from pipeline.reconstruct.consistency import Consistency, Reading
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.rig import rig_files
from tests.daemon.apps.replay.run_replay import replay
from tests.daemon.recording import small_take


def summary_in(directory: Path) -> dict[str, Any]:
    return json.loads((directory / "summary.json").read_text())


def test_the_results_have_the_documented_format(take: Path, tmp_path: Path) -> None:
    assert replay(take, "--out", tmp_path) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"cloud_0000{n}.npz" for n in (40, 41, 42)] + ["summary.json"]
    summary = summary_in(tmp_path)
    assert (summary["pairs"], summary["clouds"]) == (3, 3)
    assert summary["pairs_per_second"] > 0
    rays = small_take.LAYOUT.calibration_for(small_take.OPTICS).left.rays()
    for row in summary["per_pair"]:
        with np.load(tmp_path / f"cloud_{row['sequence']:06d}.npz", allow_pickle=False) as cloud:
            xyz, sigma, gray = cloud["xyz"], cloud["sigma_mm"], cloud["gray"]
        assert (xyz.dtype, sigma.dtype, gray.dtype) == (np.float32, np.float32, np.uint8)
        assert (xyz.shape, sigma.shape, gray.shape) == ((102, 128, 3), (102, 128), (102, 128))
        known = np.isfinite(xyz).all(axis=-1)
        assert known.sum() == row["points"] > 1000
        assert np.isnan(sigma[~known]).all()
        assert (sigma[known] > 0).mean() > 0.999
        assert {"decode", "refinement"} <= set(row["ms"])
        expected = rays[known] * xyz[known][:, 2:]
        np.testing.assert_allclose(xyz[known][:, :2], expected, atol=1e-3)  # on the viewing ray of its pixel


def names_in(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir())


def test_a_second_replay_leaves_no_cloud_of_the_first(
    take: Path, tmp_path: Path, images: list[small_take.Images], capsys: pytest.CaptureFixture[str]
) -> None:
    shorter = small_take.write(tmp_path / "shorter.mcap", images[:1])
    out = tmp_path / "out"
    assert replay(take, "--out", out) == 0
    (out / "notes.txt").touch()
    assert replay(shorter, "--out", out, "--format", "ply") == 0
    assert names_in(out) == ["cloud_000040.ply", "notes.txt", "summary.json"]
    assert "3 clouds of an earlier replay removed" in capsys.readouterr().err
    assert summary_in(out)["complete"] and summary_in(out)["take"] == str(shorter)


def test_a_replay_that_cannot_begin_leaves_the_earlier_one_alone(take: Path, tmp_path: Path) -> None:
    assert replay(take, "--out", tmp_path / "out") == 0
    before = names_in(tmp_path / "out")
    small = tmp_path / "small.yaml"
    small.write_bytes(small_take.CALIBRATION.replace(b"- 128\n", b"- 126\n", 1))
    assert replay(take, "--out", tmp_path / "out", "--calibration", small) == 2
    assert names_in(tmp_path / "out") == before and summary_in(tmp_path / "out")["complete"]


def test_an_interrupted_replay_is_marked_and_can_be_repeated(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from daemon.cli.takes.replay_directory import ReplayDirectory

    def interrupted(self: ReplayDirectory, kind: str, result: Any, parts: Any) -> None:
        write(self, kind, result, parts)
        raise KeyboardInterrupt

    write = ReplayDirectory.write
    monkeypatch.setattr(ReplayDirectory, "write", interrupted)
    assert replay(take, "--out", tmp_path) == 130
    assert summary_in(tmp_path) == {"take": str(take), "complete": False}
    assert names_in(tmp_path) == ["cloud_000040.npz", "summary.json"]
    monkeypatch.undo()
    assert replay(take, "--out", tmp_path) == 0
    assert len(names_in(tmp_path)) == 4


def test_clouds_that_no_replay_wrote_are_not_touched(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cloud_000007.ply").write_text("mine")
    assert replay(take, "--out", tmp_path) == 2
    assert "1 clouds that no replay wrote (cloud_000007.ply" in capsys.readouterr().err
    assert (tmp_path / "cloud_000007.ply").read_text() == "mine" and len(names_in(tmp_path)) == 1


def test_the_clouds_are_those_of_the_pipeline(take: Path, tmp_path: Path, images: list[small_take.Images]) -> None:
    replay(take, "--out", tmp_path)
    layout = small_take.LAYOUT
    calibration = layout.calibration_for(small_take.OPTICS)
    reconstructor = Reconstructor(calibration, layout.pattern(), layout.volume())
    for number, (left, right) in enumerate(images, 40):
        cloud = reconstructor.reconstruct(left, right)
        np.testing.assert_array_equal(read_cloud(tmp_path / f"cloud_{number:06d}.npz").xyz, cloud.xyz)


def test_a_replay_is_bit_identical_for_any_number_of_threads_and_runs(take: Path, tmp_path: Path) -> None:
    variants = {"a": (), "b": ("--threads", 1), "c": ("--threads", 2), "d": ("--repeat", 2)}
    for name, arguments in variants.items():
        assert replay(take, "--out", tmp_path / name, *arguments) == 0
    for number in (40, 41, 42):
        clouds = {(tmp_path / name / f"cloud_{number:06d}.npz").read_bytes() for name in variants}
        assert len(clouds) == 1


def test_repeated_runs_all_count_and_no_output_writes_only_the_summary(take: Path, tmp_path: Path) -> None:
    assert replay(take, "--out", tmp_path, "--no-output", "--repeat", 3) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]
    summary = summary_in(tmp_path)
    assert (summary["pairs"], summary["clouds"]) == (9, 9)
    assert [row["sequence"] for row in summary["per_pair"]] == [40] * 3 + [41] * 3 + [42] * 3
    totals = sorted(row["total_ms"] for row in summary["per_pair"])
    assert summary["pairs_per_second"] == pytest.approx(1000 / totals[4], rel=1e-3)


def test_a_take_is_measured_by_stage(take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert replay(take, "--no-output", "--repeat", 3) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]
    summary = summary_in(tmp_path)
    assert {"decode", "refinement"} <= set(summary["ms"]) and summary["follow"] is False
    for name, ms in summary["ms"].items():
        times = [row["ms"][name] for row in summary["per_pair"] if name in row["ms"]]
        assert ms == pytest.approx(np.median(times), abs=0.002)


@pytest.mark.parametrize(
    ("use_prior", "expected"), [(False, [False] * 6), (True, [False, True, True, True, True, True])]
)
def test_the_temporal_prior_is_used_only_on_request(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, use_prior: bool, expected: list[bool]
) -> None:
    original, priors = Reconstructor.reconstruct, []

    def recorded(self: Reconstructor, left: Any, right: Any, **options: Any) -> Any:
        priors.append(options.get("use_prior"))
        return original(self, left, right, **options)

    monkeypatch.setattr(Reconstructor, "reconstruct", recorded)
    monkeypatch.setattr(Reconstructor, "warm_up", lambda _, **__: None)
    assert replay(take, "--out", tmp_path, "--repeat", 2, *(["--follow"] if use_prior else [])) == 0
    assert priors == expected


@pytest.mark.parametrize("kind", ["ply", "pcd"])
def test_other_kinds_of_files(take: Path, tmp_path: Path, kind: str) -> None:
    assert replay(take, "--out", tmp_path, "--format", kind) == 0
    assert len(list(tmp_path.glob(f"cloud_*.{kind}"))) == 3
    assert not list(tmp_path.glob("*.npz"))


def test_other_settings_and_another_calibration_change_the_clouds(take: Path, tmp_path: Path) -> None:
    replay(take, "--out", tmp_path / "a")
    assert replay(take, "--out", tmp_path / "b", "--set", "min_modulation=30", "--set", "self_calibrate=false") == 0
    before, after = summary_in(tmp_path / "a"), summary_in(tmp_path / "b")
    assert after["settings"] == {"min_modulation": 30.0, "self_calibrate": False}
    assert sum(row["points"] for row in after["per_pair"]) < sum(row["points"] for row in before["per_pair"])
    other = tmp_path / "other.yaml"
    other.write_bytes(small_take.CALIBRATION + b"# the same, other bytes\n")
    assert replay(take, "--out", tmp_path / "c", "--calibration", other) == 0
    assert summary_in(tmp_path / "c")["calibration"] != before["calibration"]


def test_a_layout_that_cannot_distinguish_orders_is_a_problem(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    middle = replace(small_take.LAYOUT, projector_fraction=0.5)
    other = tmp_path / "middle.yaml"
    other.write_text(yaml.safe_dump(rig_files.calibration_mapping(middle, small_take.OPTICS), sort_keys=False))
    assert replay(take, "--out", tmp_path, "--calibration", other, "--calibration-check", "off") == 0
    # The first pair's may follow: the take is of another rig.
    problem = summary_in(tmp_path)["problems"][0]
    assert "surfaces may be at a wrong depth: the projector stands at 0.500 of the baseline" in problem
    assert f"warning: {problem}" in capsys.readouterr().err


def test_filters_fusion_and_the_output_frame_hold_in_a_replay(
    take: Path, tmp_path: Path, images: list[small_take.Images]
) -> None:
    pose = tmp_path / "pose.yaml"
    pose.write_text(
        "fringed_pose: 1\nframe: table\nmatrix: [[1, 0, 0, 1000], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    )
    assert replay(take, "--out", tmp_path / "a") == 0
    assert replay(take, "--out", tmp_path / "b", "--frame", pose, "--set", "downsampling=2") == 0
    plain, moved = (read_cloud(tmp_path / name / "cloud_000041.npz") for name in "ab")
    height, width = plain.sigma_mm.shape
    assert moved.xyz.shape == (height // 2, width // 2, 3)
    assert np.nanmedian(moved.xyz[..., 0]) == pytest.approx(1000 + np.nanmedian(plain.xyz[..., 0]), abs=10)
    still = small_take.write(tmp_path / "still.mcap", small_take.at_rest(images[0], 3))
    assert replay(still, "--out", tmp_path / "c") == 0
    assert replay(still, "--out", tmp_path / "d", "--temporal", "fuse") == 0
    newest, fused = (read_cloud(tmp_path / name / "cloud_000042.npz") for name in "cd")
    assert (np.isnan(fused.sigma_mm) == np.isnan(newest.sigma_mm)).all()
    assert np.nanmedian(fused.sigma_mm / newest.sigma_mm) < 0.98
    known = np.isfinite(newest.sigma_mm)
    assert np.mean(fused.xyz[known] != newest.xyz[known]) > 0.5
    assert replay(take, "--out", tmp_path / "e", "--temporal", "fuse", "--repeat", 2) == 2


def clouds_in(directory: Path) -> list[Any]:
    return [read_cloud(path) for path in sorted(directory.glob("cloud_*.npz"))]


def test_a_preset_gives_settings_and_fusion_that_options_change(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "presets").mkdir()
    own = {"fringed_preset": 1, "temporal": "fuse", "settings": {"smoothing_sigma_px": 1.0, "cluster_min_area": 50}}
    (tmp_path / "presets/own.yaml").write_text(yaml.safe_dump(own))
    monkeypatch.chdir(tmp_path)
    options = ["--set", "smoothing_sigma_px=1.0", "--set", "cluster_min_area=40"]
    assert replay(take, "--out", "a", "--preset", "own", "--set", "cluster_min_area=40") == 0
    assert replay(take, "--out", "b", "--temporal", "fuse", *options) == 0
    for one, other in zip(clouds_in(tmp_path / "a"), clouds_in(tmp_path / "b"), strict=True):
        np.testing.assert_array_equal(one.xyz, other.xyz)
    assert replay(take, "--no-output", "--out", "c", "--preset", "own", "--repeat", 2) == 2
    assert "--temporal fuse" in capfd.readouterr().err
    assert replay(take, "--no-output", "--out", "c", "--preset", "own", "--temporal", "off", "--repeat", 2) == 0
    assert replay(take, "--no-output", "--preset", "owm") == 2
    assert "there is no preset 'owm'; did you mean own?" in capfd.readouterr().err


def test_a_cut_take_replays_up_to_the_cut(take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = take.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * 0.7)])
    replay(take, "--out", tmp_path / "whole")
    capsys.readouterr()
    assert replay(cut, "--out", tmp_path / "cut") == 0
    assert "cut off" in capsys.readouterr().err
    assert summary_in(tmp_path / "cut")["pairs"] == 2
    for number in (40, 41):
        name = f"cloud_{number:06d}.npz"
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_errors_on_the_command_line_are_reported(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "bad.yaml").write_text("fringed_calibration: 2\n")
    small = tmp_path / "small.yaml"
    small.write_bytes(small_take.CALIBRATION.replace(b"- 128\n", b"- 126\n", 1))
    for arguments, message in (
        ((take,), "no destination for the clouds"),
        ((take, "--out", tmp_path, "--set", "min_modulatoin=3"), "did you mean min_modulation"),
        ((take, "--out", tmp_path, "--set", "min_modulation"), "expected key=value"),
        ((take, "--out", tmp_path, "--format", "obj"), "expected one of: npz, ply, pcd"),
        ((take, "--out", tmp_path, "--calibration", tmp_path / "bad.yaml"), "bad.yaml"),
        ((take, "--out", tmp_path, "--calibration", small), "use the calibration of the rig that recorded them"),
        ((tmp_path / "empty.mcap", "--out", tmp_path), "empty.mcap"),
        ((tmp_path / "absent.mcap", "--out", tmp_path), "absent.mcap"),
    ):
        assert replay(*arguments) == 2
        assert message in capsys.readouterr().err


def test_rerun_takes_a_file_or_none(take: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    file = tmp_path / "replay.rrd"
    assert replay(take, "--rerun", file) == 0
    clouds = [chunk for chunk in RrdReader(file).stream() if chunk.entity_path == "/world/cloud"]
    assert sum(chunk.to_record_batch().num_rows for chunk in clouds) == 3
    assert [p.name for p in tmp_path.iterdir()] == [file.name]


@pytest.mark.shared
def test_the_foreign_take_replays(shared_data: Callable[..., Path], tmp_path: Path) -> None:
    path = shared_data("bust", "take.mcap")
    assert replay(path, "--out", tmp_path) == 0
    cloud = read_cloud(tmp_path / "cloud_000000.npz")
    assert cloud.gray.shape == (768, 1024)
    assert np.isfinite(cloud.xyz[..., 2]).mean() > 0.4


def test_rerun_is_imported_only_on_request(take: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from daemon.cli.entry import run; "
        f"assert run(['replay', {str(take)!r}, '--out', {str(tmp_path)!r}]) == 0; "
        "assert not {'rerun', 'matplotlib', 'sim'} & {name.partition('.')[0] for name in sys.modules}"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert process.returncode == 0, process.stderr


def test_one_pair_that_contradicts_the_calibration_is_withheld_and_changes_the_exit_status(
    take: Path, tmp_path: Path, images: list[small_take.Images], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    original = ConsistencyCheck.check

    def check(self: ConsistencyCheck, left: Any, *rest: Any) -> Consistency:
        moved = np.array_equal(left, images[1][0])
        return judged({"order_cost": Reading(2.0, 0.0)}, "it has moved") if moved else original(self, left, *rest)

    monkeypatch.setattr(ConsistencyCheck, "check", check)
    assert replay(take, "--out", tmp_path) == INCONSISTENT == 3
    assert [row["points"] > 0 for row in summary_in(tmp_path)["per_pair"]] == [True, False, True]
    message = capsys.readouterr().err
    assert "1 of 3 reconstructions contradict the calibration" in message and "pair 41: it has moved" in message
    assert replay(take, "--out", tmp_path, "--calibration-check", "warn") == 0
    assert all(row["points"] > 0 for row in summary_in(tmp_path)["per_pair"])
