"""Run again, only what is missing or would differ is done; failures are remembered, and one run at a time writes."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import pytest

from daemon.apps.reprocess import run as run_module
from daemon.apps.reprocess.destination.lock import locked
from daemon.apps.reprocess.engine.tasks import Completed, EngineLostError, InlineEngine
from daemon.apps.reprocess.locations import location
from daemon.apps.reprocess.work import chunk_work
from daemon.common.errors import DaemonError
from pipeline.common.settings import Settings
from tests.daemon.apps.reprocess.takes import files_of, replayed, reprocess, write
from tests.daemon.recording import small_take

Images = list[small_take.Images]


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory, images: Images) -> Path:
    return write(tmp_path_factory.mktemp("takes") / "a.mcap", images, 7)


@pytest.fixture(scope="module")
def expected(take: Path) -> dict[str, bytes]:
    """The clouds of a replay of the take."""
    return replayed(take)[0]


class LimitedEngine(InlineEngine):
    """Is lost after some tasks."""

    def __init__(self, tasks: int) -> None:
        super().__init__()
        self.left = tasks

    def wait(self, timeout_s: float) -> list[Completed]:
        if self.left == 0:
            raise EngineLostError("gone")
        self.left -= 1
        return super().wait(timeout_s)


class KillingEngine(InlineEngine):
    """Reports a killed worker for the chunk of some number."""

    def __init__(self, chunk: int) -> None:
        super().__init__()
        self.chunk = chunk

    def wait(self, timeout_s: float) -> list[Completed]:
        label, *_ = self._calls[0]
        if label[0] == "chunk" and label[2] == self.chunk:
            self._calls.popleft()
            return [Completed(label, error="the worker was killed")]
        return super().wait(timeout_s)


def stamps(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("cloud_*")}


def test_a_second_run_does_nothing(take: Path, tmp_path: Path) -> None:
    reprocess([take], tmp_path, chunk_pairs=2)
    before = stamps(tmp_path / "a")
    totals = reprocess([take], tmp_path, chunk_pairs=2)
    assert (totals.done, totals.computed) == (7, 0)
    assert stamps(tmp_path / "a") == before
    assert totals.sums.clouds == 7


@pytest.mark.parametrize("tasks", [pytest.param(n, marks=[pytest.mark.long] * (n in (2, 4, 5))) for n in range(1, 7)])
def test_a_run_that_was_cut_off_anywhere_is_completed(
    take: Path, expected: dict[str, bytes], tmp_path: Path, tasks: int
) -> None:
    with pytest.raises(EngineLostError):
        reprocess([take], tmp_path, chunk_pairs=2, engine=LimitedEngine(tasks))
    done = len(list((tmp_path / "a" / "chunks").glob("*.json"))) if (tmp_path / "a").exists() else 0
    assert done == max(0, tasks - 1) and not (tmp_path / "a" / "summary.json").exists()
    totals = reprocess([take], tmp_path, chunk_pairs=2)
    assert totals.computed < 7 or done == 0
    assert files_of(tmp_path / "a") == expected
    assert (tmp_path / "a" / "summary.json").exists()


def test_a_missing_or_damaged_manifest_costs_its_own_chunk(
    take: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    reprocess([take], tmp_path, chunk_pairs=2)
    manifests = sorted((tmp_path / "a" / "chunks").iterdir())
    manifests[2].unlink()
    manifests[3].write_bytes(manifests[3].read_bytes()[:100])
    assert reprocess([take], tmp_path, chunk_pairs=2).computed == 4
    assert files_of(tmp_path / "a") == expected


def test_other_settings_do_all_again_and_leave_no_file_of_before(take: Path, tmp_path: Path) -> None:
    reprocess([take], tmp_path, chunk_pairs=2)
    totals = reprocess([take], tmp_path, chunk_pairs=2, settings=Settings(cluster_min_area=60), kind="ply")
    assert totals.computed == 7
    assert {name.rpartition(".")[2] for name in files_of(tmp_path / "a")} == {"ply"}


def test_other_parts_do_all_again(take: Path, tmp_path: Path) -> None:
    reprocess([take], tmp_path, chunk_pairs=2)
    for parts in (("xyz", "rgb"), ()):
        assert [reprocess([take], tmp_path, chunk_pairs=2, parts=parts).computed for _ in range(2)] == [7, 0]
        assert files_of(tmp_path / "a") == replayed(take, parts=parts)[0]


def test_a_changed_recording_is_done_again(images: Images, tmp_path: Path) -> None:
    take = write(tmp_path / "in" / "a.mcap", images, 4)
    reprocess([take], tmp_path / "out", chunk_pairs=2)
    take.unlink()
    write(take, images[1:], 4, first=41)
    assert reprocess([take], tmp_path / "out", chunk_pairs=2).computed == 4
    assert files_of(tmp_path / "out" / "a") == replayed(take)[0]


def test_a_failure_is_remembered_until_it_is_retried(take: Path, expected: dict[str, bytes], tmp_path: Path) -> None:
    totals = reprocess([take], tmp_path, chunk_pairs=2, engine=KillingEngine(2))
    assert totals.failures == ["a: pairs 42 to 43: the worker was killed"]
    assert totals.done == 5 and not (tmp_path / "a" / "summary.json").exists()
    again = reprocess([take], tmp_path, chunk_pairs=2)
    assert (again.failures, again.computed) == (totals.failures, 0)
    retried = reprocess([take], tmp_path, chunk_pairs=2, retry_failed=True)
    assert (retried.failures, retried.computed) == ([], 2)
    assert files_of(tmp_path / "a") == expected
    assert not list((tmp_path / "a" / "chunks").glob("*.failed.json"))


def test_what_a_store_refuses_for_a_while_is_tried_again(
    take: Path, expected: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, errors = chunk_work.write_whole, iter([ConnectionError("503")] * 3)

    def failing(place: Any, data: bytes) -> None:
        for error in errors:
            raise error
        original(place, data)

    monkeypatch.setattr(chunk_work, "write_whole", failing)
    monkeypatch.setattr(run_module, "RETRY_S", (0.0,) * 5)
    totals = reprocess([take], tmp_path, chunk_pairs=2)
    assert not totals.failures
    assert files_of(tmp_path / "a") == expected


def test_a_store_that_refuses_for_good_is_a_failure(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def failing(place: Any, _: bytes) -> None:
        calls.append(place)
        raise ConnectionError("503 slow down")

    monkeypatch.setattr(chunk_work, "write_whole", failing)
    monkeypatch.setattr(run_module, "RETRY_S", (0.0,) * 5)
    totals = reprocess([take], tmp_path, chunk_pairs=100)
    assert totals.failures == ["a: pairs 40 to 46: 503 slow down"]
    assert len(calls) == run_module.ATTEMPTS


def test_a_full_disk_fails_at_once_and_keeps_what_was_written(
    take: Path, expected: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, room = chunk_work.write_whole, 4

    def limited(place: Any, data: bytes) -> None:
        nonlocal room
        room -= 1
        if room < 0:
            raise OSError(errno.ENOSPC, "No space left on device", str(place))
        original(place, data)

    monkeypatch.setattr(chunk_work, "write_whole", limited)
    totals = reprocess([take], tmp_path, chunk_pairs=2)
    assert totals.done == 4 and all("No space left" in failure for failure in totals.failures)
    monkeypatch.setattr(chunk_work, "write_whole", original)
    assert reprocess([take], tmp_path, chunk_pairs=2, retry_failed=True).computed == 3
    assert files_of(tmp_path / "a") == expected


def test_temporary_files_of_killed_processes_go_at_the_end(take: Path, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    left = tmp_path / "a" / ".cloud_000040.npz.x1.tmp"
    left.write_bytes(b"half a cloud")
    reprocess([take], tmp_path)
    assert not left.exists()


@pytest.mark.parametrize("where", ["local", "memory"])
def test_a_second_run_into_one_destination_is_refused(tmp_path: Path, where: str) -> None:
    if where == "memory":
        pytest.importorskip("upath")
    root = tmp_path if where == "local" else location(f"memory://{tmp_path.name}")
    refusal = pytest.raises(DaemonError, match=r"process \d+ on .* is reprocessing into this destination")
    with locked(root), refusal, locked(root):
        pass
    with locked(root):
        pass


def test_the_manifest_names_source_calibration_settings_and_release(take: Path, tmp_path: Path) -> None:
    reprocess([take], tmp_path)
    [path] = (tmp_path / "a" / "chunks").iterdir()
    manifest = json.loads(path.read_text())
    assert len(manifest["key"]) == len(manifest["source"]) == 64
    assert manifest["calibration"].startswith("sha256:")
    assert set(manifest["release"]) == {"fringed", "numpy", "numba"}
    assert manifest["before"]["corrections"] == [] and manifest["after"]["corrections"][0][1] is True
    assert [row["sequence"] for row in manifest["rows"]] == list(range(40, 47))


def test_damage_and_a_store_that_fails_at_the_same_time(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = bytearray(take.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 64] = bytes(64)
    damaged = tmp_path / "b.mcap"
    damaged.write_bytes(data)
    original, failed = run_module.process_chunk, set()

    def failing_once(task: chunk_work.ChunkTask) -> chunk_work.ChunkOutcome:
        if task.chunk.items[-1].sequence == 46 and task.chunk.name not in failed:
            failed.add(task.chunk.name)
            return chunk_work.ChunkOutcome(error="503", transient=True)
        return original(task)

    monkeypatch.setattr(run_module, "process_chunk", failing_once)
    monkeypatch.setattr(run_module, "RETRY_S", (0.6,) * 5)
    totals = reprocess([damaged], tmp_path / "out", chunk_pairs=2)
    assert not totals.failures and totals.closed[0].damaged
    assert files_of(tmp_path / "out" / "b") == replayed(damaged)[0]


def test_a_worker_of_another_release_is_refused(take: Path, tmp_path: Path) -> None:
    other = {"fringed": "0.0.1", "numpy": "1.0", "numba": "0.1"}
    totals = reprocess([take], tmp_path, release=other)
    assert not files_of(tmp_path / "a")
    assert "instead of 0.0.1" in totals.failures[0] and "install the same packages there" in totals.failures[0]
