"""References and history on disk: bounded, per calibration, and no reason to stop measuring."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest

from daemon.monitoring.calibration_drift import store as store_module
from daemon.monitoring.calibration_drift.store import Store
from daemon.monitoring.calibration_drift.verdicts import Reference

SOME = {"column_px": Reference(0.012, 0.003), "epipolar_px": Reference(-0.2, 0.01)}


def test_references_come_back_for_their_calibration_only(tmp_path: Path) -> None:
    directory = tmp_path / "check"
    Store(directory, "a").save(SOME, 1)
    assert Store(directory, "a").references() == SOME
    assert Store(directory, "b").references() == {}
    Store(directory, "b").save({"column_px": Reference(1.0, 0.0)}, 2)
    assert Store(directory, "a").references() == SOME


def test_old_calibrations_go_when_there_are_too_many(tmp_path: Path) -> None:
    for number in range(store_module._MAX_CALIBRATIONS + 10):
        Store(tmp_path, str(number)).save(SOME, number)
    known = json.loads((tmp_path / "references.json").read_text())["calibrations"]
    assert len(known) == store_module._MAX_CALIBRATIONS and str(number) in known and "0" not in known


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b'{"calibrations": 3}', b"\xff\xfe"])
def test_a_broken_file_is_reported_and_learned_again(
    tmp_path: Path, data: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "references.json").write_bytes(data)
    with caplog.at_level(logging.WARNING):
        assert Store(tmp_path, "a").references() == {}
    assert "learned again" in caplog.text
    Store(tmp_path, "a").save(SOME, 1)
    assert Store(tmp_path, "a").references() == SOME


@pytest.mark.parametrize("entry", [3, {"observables": 3}, {"observables": {"x": 3, "y": {"value": "a", "scatter": 1}}}])
def test_entries_that_make_no_sense_are_passed_over(tmp_path: Path, entry: object) -> None:
    (tmp_path / "references.json").write_text(json.dumps({"calibrations": {"a": entry}}))
    assert Store(tmp_path, "a").references() == {}


def test_the_history_is_lines_of_json_and_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "MAX_HISTORY_BYTES", 1000)
    store = Store(tmp_path, "a")
    for number in range(200):
        store.append({"number": number})
    sizes = [path.stat().st_size for path in tmp_path.iterdir()]
    assert len(sizes) == 2 and max(sizes) <= 1000
    rows = [json.loads(line) for line in (tmp_path / "history.jsonl").read_text().splitlines()]
    assert rows[-1] == {"number": 199}


def test_a_disk_error_is_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("")
    store = Store(tmp_path / "file" / "check", "a")
    with caplog.at_level(logging.WARNING):
        for number in range(5):
            store.append({"number": number})
        store.save(SOME, 1)
    assert caplog.text.count("cannot write to") == 1
