"""The list of takes, their check, their repair, and the command that shows them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.cli.command_table import invoke
from daemon.recording.format.errors import TakeError
from daemon.recording.read import part_reader
from daemon.recording.read.catalog import CACHE, Listing, scan
from daemon.recording.read.take_reader import TakeReader
from daemon.recording.repair import repair
from sim.rig import rig_files
from tests.daemon.recording.small_take import CALIBRATION, LAYOUT
from tests.daemon.recording.takes import pair, unpaired, write, writer
from tools.waiting import wait_until


def good(path: Path, items: list[Any], **options: Any) -> dict[str, Any]:
    """A take whose attachments are right too."""
    values = {"calibration_data": CALIBRATION, "pattern": rig_files.pattern_mapping(LAYOUT)}
    return write(path, items, **(values | {"volume": rig_files.volume_mapping(LAYOUT)} | options))


def cut(path: Path, at: int) -> Path:
    """A take that a crash left: unfinished, cut at this byte."""
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(path.read_bytes()[:at])
    path.unlink()
    return partial


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Three takes and some invalid files."""
    good(tmp_path / "a.mcap", [pair(n) for n in range(12)], max_part_bytes=20_000)
    good(tmp_path / "b.mcap", [pair(500), unpaired("right", 501)], session="another")
    good(tmp_path / "c.mcap", [pair(n) for n in range(900, 905)])
    cut(tmp_path / "c.mcap", -2000)
    (tmp_path / "noise.mcap").write_bytes(np.random.default_rng(1).bytes(3000))
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "a_part002_notes.txt").write_text("not read")
    return tmp_path


def by_name(listing: Listing) -> dict[str, Any]:
    return {take.name: take for take in listing.takes}


def test_takes_are_listed_from_their_indexes(takes: Path) -> None:
    listing = scan(takes)
    found = by_name(listing)
    assert sorted(found) == ["a", "b", "c"]
    assert (found["a"].state, found["a"].frames, len(found["a"].files)) == ("whole", [12, 12], 4)
    assert found["a"].duration_s == pytest.approx(11 * 0.033, abs=2e-3)
    assert (found["b"].state, found["b"].frames) == ("whole", [1, 2])
    assert found["c"].state == "unfinished" and "cut off" in found["c"].problems[0]
    assert 3 <= found["c"].frames[0] <= 5
    assert sorted(listing.other_files) == ["empty.mcap", "noise.mcap"]


def test_the_count_without_an_index_is_the_count_with_it(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [pair(1), unpaired("left", 2), pair(3)])
    (whole,) = scan(tmp_path).takes
    with TakeReader(tmp_path / "a.mcap") as take:
        end = take.parts[0].index.data[-1].end
    cut(tmp_path / "a.mcap", end + 200)
    (walked,) = scan(tmp_path).takes
    assert walked.frames == whole.frames == [3, 2]
    assert (walked.start_ns, walked.end_ns) == (whole.start_ns, whole.end_ns)


def test_what_was_seen_once_is_not_opened_again(takes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = scan(takes)
    opened: list[str] = []
    real = part_reader.PartReader.__init__

    def note(self: Any, path: Path) -> None:
        opened.append(path.name)
        real(self, path)

    monkeypatch.setattr(part_reader.PartReader, "__init__", note)
    again = scan(takes)
    assert [take.as_dict() for take in again.takes] == [take.as_dict() for take in first.takes]
    assert again.other_files == first.other_files
    assert opened == ["c.mcap.partial"]
    write(takes / "d.mcap", [pair(7)])
    assert "d" in by_name(scan(takes))


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b'{"version": 2, "files": [{}]}', b'{"version": 2, "files": 5}', b"[" * 100_000]
)
def test_any_cache_is_survived(takes: Path, content: bytes) -> None:
    first = [take.as_dict() for take in scan(takes).takes]
    (takes / CACHE).write_bytes(content)
    assert [take.as_dict() for take in scan(takes).takes] == first


def test_a_lie_in_the_cache_is_found_by_size_and_time(takes: Path) -> None:
    scan(takes)
    rows = json.loads((takes / CACHE).read_text())
    for entry in rows["files"]:
        entry["left"], entry["size"] = 999, entry["size"] + 1
    (takes / CACHE).write_text(json.dumps(rows))
    assert by_name(scan(takes))["a"].frames == [12, 12]


def test_any_bytes_in_the_directory_are_survived(takes: Path) -> None:
    rng = np.random.default_rng(3)
    data = (takes / "a.mcap").read_bytes()
    for _ in range(60):
        damaged = bytearray(data[: int(rng.integers(8, len(data)))])
        for at in rng.integers(8, len(damaged) + 1, 4):
            damaged[int(at) - 1] ^= int(rng.integers(1, 256))
        (takes / "z.mcap").write_bytes(damaged)
        listing = scan(takes)
        assert set(by_name(listing)) | set(listing.other_files) >= {"a", "b", "c", "noise.mcap", "empty.mcap"}


def test_a_running_take_is_neither_repaired_nor_removed(tmp_path: Path) -> None:
    recorder = writer(tmp_path / "a.mcap")
    assert recorder.offer(pair(1))
    wait_until(lambda: recorder.status()["pairs"] == 1)
    (take,) = scan(tmp_path).takes
    assert take.state == "writing" and take.problems == []
    with pytest.raises(TakeError, match="being written"):
        repair(tmp_path / "a.mcap.partial")
    assert run(tmp_path, "rm", "a", "--yes") == 1
    recorder.close()
    assert scan(tmp_path).takes[0].state == "whole"


def test_a_cut_take_is_repaired_and_nothing_sound_is_lost(takes: Path) -> None:
    partial = takes / "c.mcap.partial"
    with TakeReader(partial) as take:
        before = [(p.sequence, p.left.tobytes(), p.right.tobytes(), p.t_ns) for p in take.pairs()]
        attached = dict(take.attachments)
    done = repair(partial)
    assert done is not None and done.file == takes / "c.mcap" and done.kept.exists()
    with TakeReader(takes / "c.mcap") as take:
        assert [(p.sequence, p.left.tobytes(), p.right.tobytes(), p.t_ns) for p in take.pairs()] == before
        assert take.attachments == attached and take.whole
        assert take.metadata["session"] == "a session"
    assert not partial.exists() and by_name(scan(takes))["c"].state == "whole"
    assert repair(takes / "c.mcap") is None


def test_a_whole_file_that_only_lacks_its_name_gets_it(takes: Path) -> None:
    (takes / "b.mcap").rename(takes / "b.mcap.partial")
    assert repair(takes / "b.mcap.partial") is not None
    assert by_name(scan(takes))["b"].files == ["b.mcap"]


def test_a_damaged_chunk_costs_only_its_pair(takes: Path) -> None:
    path = takes / "a.mcap"
    with TakeReader(path) as take:
        place = take.parts[0].index.data[1]
    data = bytearray(path.read_bytes())
    data[place.offset + place.length // 2] ^= 1
    path.write_bytes(data)
    done = repair(path)
    assert done is not None and done.kept.read_bytes() == bytes(data)
    with TakeReader(path) as take:
        assert [p.sequence for p in take.pairs()] == [n for n in range(12) if n != 1]
        assert take.whole


def test_a_repair_replaces_no_file_that_appears_meanwhile(takes: Path) -> None:
    partial = takes / "c.mcap.partial"
    before = partial.read_bytes()
    with pytest.raises(TakeError, match=r"c\.mcap exists already; move it away first"):
        repair(partial, lambda _done, _size: (takes / "c.mcap").write_text("another"))
    assert partial.read_bytes() == before
    assert (takes / "c.mcap").read_text() == "another"
    assert not [path.name for path in takes.iterdir() if "repairing" in path.name or "broken" in path.name]


def test_a_repair_that_finds_no_room_changes_nothing(takes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    partial = takes / "c.mcap.partial"
    before = partial.read_bytes()

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("daemon.recording.repair.PartWriter.write", full)
    with pytest.raises(OSError, match="No space left"):
        repair(partial)
    assert partial.read_bytes() == before
    assert not (takes / "c.mcap").exists() and not list(takes.glob(".*"))


def run(directory: Path, *arguments: str) -> int:
    """The exit status of ``fringed takes``; expected errors give 1, as at the console."""
    try:
        return invoke(["takes", "--dir", str(directory), *arguments])
    except (TakeError, OSError):
        return 1


def test_the_exit_status_of_the_command(takes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(takes) == 0
    out, err = capsys.readouterr()
    assert "whole" in out and "unfinished" in out
    assert f"{takes}/noise.mcap: no take" in err and "not an MCAP file" in err
    assert run(takes, "show", "c") == 1 and run(takes, "show", "b") == 0
    assert run(takes, "check", "a", "b") == 0
    assert run(takes, "check") == 1
    assert "noise.mcap" in capsys.readouterr().err
    assert run(takes, "show", "nothing") == 1
    assert run(takes, "repair", "c") == 0 and run(takes, "check", "c") == 0
    assert run(takes, "rm", "c", "--yes") == 0 and "c" not in by_name(scan(takes))
    assert run(takes / "nowhere") == 1


def test_the_command_prints_json(takes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(takes, "list", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert [take["name"] for take in report["takes"]] == ["a", "b", "c"]
    assert sorted(report["garbage"]) == ["empty.mcap", "noise.mcap"]
