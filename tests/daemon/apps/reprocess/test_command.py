"""The command line: what it refuses, what it reports, and what it does without the extra."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from daemon.apps.replay.runner import Replay
from daemon.cli.entry import run
from daemon.kernels import processes
from daemon.kernels.jobs import measuring_jobs
from daemon.recording.read.take_reader import TakeReader
from pipeline.common.settings import Settings
from tests.daemon.apps.reprocess.takes import files_of, replayed, write
from tests.daemon.recording import small_take

Images = list[small_take.Images]


@pytest.fixture
def take(tmp_path: Path, images: Images) -> Path:
    return write(tmp_path / "in" / "a.mcap", images, 5)


def reprocess(*arguments: object) -> int:
    return run(["reprocess", *map(str, arguments)])


def test_without_workers_all_is_done_in_this_process(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert reprocess(take, "--out", tmp_path / "out", "--workers", 0, "--chunk", 2) == 0
    assert files_of(tmp_path / "out" / "a") == replayed(take)[0]
    assert "5 of 5 pairs of 1 recordings done, 0 of them before" in capsys.readouterr().out


def test_parts_are_those_of_the_command_replay(take: Path, tmp_path: Path) -> None:
    options = "--format", "ply", "--parts", "xyz,rgb,normals"
    assert reprocess(take, "--out", tmp_path / "out", "--workers", 0, *options) == 0
    assert run(["replay", str(take), "--out", str(tmp_path / "replayed"), *options]) == 0
    assert files_of(tmp_path / "out" / "a") == files_of(tmp_path / "replayed")


def test_an_unreachable_scheduler_is_reported_without_dasks_twenty_seconds(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", None)  # it repeats what was refused
    assert reprocess(take, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9") == 1
    assert "--scheduler tcp://127.0.0.1:9: no Dask scheduler answers there: " in capsys.readouterr().err


def test_kernels_are_compiled_once_before_the_workers_start(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled: list[str] = []
    monkeypatch.setattr(processes, "compile_kernels", lambda jobs, _: compiled.extend(jobs))
    assert reprocess(take, "--out", tmp_path / "out", "--workers", 0) == 0
    assert compiled == list(measuring_jobs("rgb8"))


def test_without_the_extra_the_command_names_it(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setitem(sys.modules, "dask", None)
    assert reprocess(take, "--out", tmp_path / "out") == 1
    assert run(["worker", "tcp://127.0.0.1:9"]) == 1
    errors = capsys.readouterr().err
    assert errors.count("pip install 'fringed-rig[cluster]'") == 2
    assert "--workers 0 works without" in errors


def test_a_dry_run_changes_nothing_and_estimates(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reprocess(take, "--out", tmp_path / "out", "--dry-run", "--workers", 4) == 0
    out = capsys.readouterr().out
    assert "5 pairs or sets in 1 recordings, 0.00 GB; 5 of them to do" in out
    assert "ms each by one thread: about" in out and "with 4 workers" in out
    assert not (tmp_path / "out").exists()


def test_failures_are_listed_and_give_exit_status_1(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (take.parent / "foreign.mcap").write_bytes(b"no take at all")
    assert reprocess(take.parent, "--out", tmp_path / "out", "--workers", 0) == 1
    captured = capsys.readouterr()
    assert "failed: foreign: " in captured.err and "--retry-failed does these again" in captured.err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert len(report["failures"]) == 1 and report["worst"][0] == "foreign"
    assert {row["name"]: row["done"] for row in report["per_recording"]} == {"a": 5, "foreign": 0}
    assert sum(report["histograms"]["coverage"]["counts"]) == report["means"]["clouds"] == 5


def test_the_report_is_well_formed_and_links_the_recordings(take: Path, tmp_path: Path) -> None:
    take.rename(take.with_name("a <b> & c.mcap"))
    assert reprocess(take.parent, "--out", tmp_path / "out", "--workers", 0) == 0
    page = (tmp_path / "out" / "report.html").read_text().partition("\n")[2]
    root = ET.fromstring(page)
    links = [link.get("href") for link in root.iter("{http://www.w3.org/1999/xhtml}a")]
    assert links == ["a%20%3Cb%3E%20%26%20c/"] * 2
    assert len(list(root.iter("{http://www.w3.org/2000/svg}svg"))) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--format", "stl"], "unknown cloud format 'stl'"),
        (["--calibration-check", "maybe"], "expected one of: withhold, warn, off"),
        (["--scheduler", "tcp://127.0.0.1:9", "--workers", "2"], "fringed worker ADDRESS"),
        (["--set", "nonsense=1,2"], "there is no setting 'nonsense'"),
        (["--set", "cluster_min_area=a,b"], "expected key=value,value"),
        (["--parts", "rgb"], "without 'xyz'"),
        (["--set", "nonsense=1"], "there is no setting 'nonsense'"),
        (["--calibration", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_wrong_arguments_are_refused(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert reprocess(take, "--out", tmp_path / "out", *arguments) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_settings_are_compared_on_a_sample(take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(take.with_name("b.mcap"), small_take.render(), 7)
    arguments = "--set", "min_modulation=5,40", "--set", "cluster_min_area=60,120", "--sample", 4, "--workers", 0
    assert reprocess(take.parent, "--out", tmp_path / "out", *arguments) == 0
    rows = json.loads((tmp_path / "out" / "grid.json").read_text())["rows"]
    assert [row["settings"] for row in rows] == [
        {"min_modulation": a, "cluster_min_area": b} for a in (5, 40) for b in (60, 120)
    ]
    assert all(row["clouds"] == 4 and row["ms"] > 0 and sum(row["verdicts"].values()) == 4 for row in rows)
    assert rows[0]["coverage"] > rows[2]["coverage"] and rows[0]["rejected"] < rows[2]["rejected"]
    assert "grid.html" in capsys.readouterr().out
    assert not list((tmp_path / "out").glob("*/cloud_*"))
    page = (tmp_path / "out" / "grid.html").read_text().partition("\n")[2]
    assert len(list(ET.fromstring(page).iter("{http://www.w3.org/1999/xhtml}tr"))) == 5


def test_the_figures_of_a_comparison_are_those_of_a_replay(take: Path, tmp_path: Path) -> None:
    arguments = "--set", "min_modulation=5,30", "--sample", 5, "--workers", 0
    assert reprocess(take, "--out", tmp_path / "out", *arguments) == 0
    rows = json.loads((tmp_path / "out" / "grid.json").read_text())["rows"]
    for row in rows:
        settings = Settings(min_modulation=float(row["settings"]["min_modulation"]))
        with TakeReader(take) as reader:
            points = [result.cloud.points for result in Replay(reader, settings, calibration_check="warn").results()]
        assert row["points"] == pytest.approx(sum(points) / 5, abs=0.06)
