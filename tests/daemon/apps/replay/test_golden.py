"""Golden files: ``fringed replay --bless`` and ``--expect``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.daemon.apps.replay.run_replay import replay
from tests.daemon.recording import small_take


def test_a_golden_file_matches_its_own_take_and_deviations_are_reported(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    golden = tmp_path / "golden.json"
    assert replay(take, "--bless", golden) == 0
    assert replay(take, "--expect", golden) == 0
    assert "as expected: 3 pairs" in capsys.readouterr().out
    assert replay(take, "--expect", golden, "--set", "min_modulation=30") == 1
    shown = capsys.readouterr().out
    for column in ("Deviations", "points", "coverage", "filled"):
        assert column in shown


def test_a_depth_deviation_is_detected_with_an_equal_number_of_points(take: Path, tmp_path: Path) -> None:
    golden = tmp_path / "golden.json"
    replay(take, "--bless", golden)
    content = json.loads(golden.read_text())
    for row in content["pairs"][1]["median_mm"]:
        row[:] = [None if depth is None else depth + 0.2 for depth in row]
    golden.write_text(json.dumps(content))
    assert replay(take, "--expect", golden) == 1
    content["tolerances"]["depth_mm"] = 0.3
    golden.write_text(json.dumps(content))
    assert replay(take, "--expect", golden) == 0
    assert replay(take, "--bless", golden) == 0  # --bless keeps edited tolerances
    assert json.loads(golden.read_text())["tolerances"]["depth_mm"] == 0.3


def test_a_standard_deviation_that_changed_is_detected_and_files_without_it_are_compared(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    golden = tmp_path / "golden.json"
    replay(take, "--bless", golden)
    content = json.loads(golden.read_text())
    for row in content["pairs"][1]["sigma_mm"]:
        row[:] = [None if sigma is None else 0.8 * sigma for sigma in row]
    golden.write_text(json.dumps(content))
    capsys.readouterr()
    assert replay(take, "--expect", golden) == 1
    assert "sigma of" in capsys.readouterr().out
    content["tolerances"]["sigma_percent"] = 30
    golden.write_text(json.dumps(content))
    assert replay(take, "--expect", golden) == 0
    content["pairs"][1]["sigma_mm"][1] = [None] * len(content["pairs"][1]["sigma_mm"][1])
    golden.write_text(json.dumps(content))
    assert replay(take, "--expect", golden) == 1
    for pair in content["pairs"]:
        del pair["sigma_mm"]
    del content["tolerances"]["sigma_percent"]
    golden.write_text(json.dumps(content))
    assert replay(take, "--expect", golden) == 0


def test_a_missing_and_an_additional_pair_are_reported(
    take: Path, tmp_path: Path, images: list[small_take.Images], capsys: pytest.CaptureFixture[str]
) -> None:
    golden = tmp_path / "golden.json"
    replay(take, "--bless", golden)
    later = small_take.write(tmp_path / "later.mcap", images, first=41)
    assert replay(later, "--expect", golden) == 1
    shown = capsys.readouterr().out
    assert "must exist" in shown
    assert "must not exist" in shown


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fringed_golden": 2}, "fringed_golden is 2"),
        ({"tolerances": {"depth": 1}}, "tolerances.depth is unknown"),
        ({"tolerances": {"depth_mm": "1"}}, "tolerances.depth_mm is '1'"),
        ({"cell": 0}, "cell is 0"),
        ({"pairs": [{}]}, "size is missing"),
    ],
)
def test_an_invalid_golden_file_is_rejected_by_name(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any], message: str
) -> None:
    golden = tmp_path / "golden.json"
    golden.write_text(json.dumps({"fringed_golden": 1, "cell": 32, "pairs": []} | change))
    assert replay(take, "--expect", golden) == 2
    error = capsys.readouterr().err
    assert "golden.json" in error
    assert message in error
