"""Whatever the disk does: the measuring never waits, the take goes on when it can, and what was written is readable."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.recording.read.take_reader import TakeReader
from daemon.recording.write.take_writer import TakeWriter
from tests.daemon.recording.faulty_disk import Disk, disk
from tests.daemon.recording.takes import pair, writer
from tools.waiting import wait_until

__all__ = ["disk"]
RETRY_S = 0.02


def take(path: Path, **options: Any) -> TakeWriter:
    return writer(path, **({"retry_s": RETRY_S, "min_free_bytes": 0} | options))


def read(path: Path) -> list[int]:
    """Numbers of the pairs; each image must be the one that was written."""
    with TakeReader(path) as reader:
        pairs = list(reader.pairs())
    for one in pairs:
        wrote = pair(one.sequence)
        np.testing.assert_array_equal(one.left, wrote.left.image)
        np.testing.assert_array_equal(one.right, wrote.right.image)
    return [one.sequence for one in pairs]


def written(recorder: TakeWriter, pairs: int) -> None:
    wait_until(lambda: recorder.status()["pairs"] >= pairs, 60)


@pytest.mark.parametrize("mode", ["full", "io", "readonly", "gone"])
def test_an_interrupted_take_goes_on_in_a_new_part_and_loses_nothing_that_fits_the_queue(
    tmp_path: Path, disk: Disk, mode: str
) -> None:
    recorder = take(tmp_path / "take.mcap")
    assert all(recorder.offer(pair(n)) for n in range(5))
    written(recorder, 5)
    disk.mode = mode
    assert all(recorder.offer(pair(n)) for n in range(5, 10))
    wait_until(lambda: "problem" in recorder.status())
    status = recorder.status()
    assert status["recording"] and str(tmp_path) in status["problem"]
    wait_until(lambda: disk.asked[f"{mode} open"] >= 3)
    disk.heal()
    written(recorder, 10)
    assert "problem" not in recorder.status()
    recorder.close()
    status = recorder.status()
    assert (status["pairs"], status["dropped"], status["interruptions"]) == (10, {}, 1)
    assert read(tmp_path / "take.mcap") == list(range(10))
    with TakeReader(tmp_path / "take.mcap") as reader:
        first, second = reader.parts
        assert second.metadata["continues"] == first.path.name
        assert second.metadata["session"] == first.metadata["session"]
    assert len(list(tmp_path.iterdir())) == 2


def test_without_a_disk_what_does_not_fit_is_dropped_and_counted(tmp_path: Path, disk: Disk) -> None:
    recorder = take(tmp_path / "take.mcap", queue=3)
    disk.mode = "gone"
    assert recorder.offer(pair(0))
    wait_until(lambda: "problem" in recorder.status())
    taken = [recorder.offer(pair(n)) for n in range(1, 9)]
    assert sum(taken) <= 3
    assert recorder.status()["dropped"] == {"no_disk": taken.count(False)}
    recorder.close()
    status = recorder.status()
    assert sum(status["dropped"].values()) == 9 - status["pairs"]
    assert not status["recording"] and "No such device" in status["problem"]


def test_a_hanging_disk_is_reported_and_blocks_no_other_thread(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.recording.write.take_writer.HUNG_S", 0.05)
    recorder = take(tmp_path / "take.mcap", queue=4)
    disk.hang()
    assert recorder.offer(pair(0))
    wait_until(lambda: "not answered" in recorder.status().get("problem", ""))
    taken = [recorder.offer(pair(n)) for n in range(1, 9)]
    assert taken == [True] * 4 + [False] * 4
    disk.heal()
    written(recorder, 5)
    wait_until(lambda: "problem" not in recorder.status())
    recorder.close()
    assert read(tmp_path / "take.mcap") == [0, 1, 2, 3, 4]
    assert recorder.status()["dropped"] == {"queue_full": 4}


def test_the_guard_stops_before_the_disk_is_full_and_goes_on_when_there_is_room(tmp_path: Path) -> None:
    free = [5 << 30]
    recorder = take(tmp_path / "take.mcap", min_free_bytes=1 << 30, free_bytes=lambda _: free[0])
    assert recorder.offer(pair(0))
    written(recorder, 1)
    free[0] = 1 << 30
    assert recorder.offer(pair(1))
    wait_until(lambda: "problem" in recorder.status())
    assert "1074 MB free" in recorder.status()["problem"]
    free[0] += 10 << 20
    wait_until(lambda: "it resumes at 1141 MB" in recorder.status()["problem"])
    assert (tmp_path / "take.mcap").exists()  # whole, while there is still room for its index
    free[0] = 2 << 30
    written(recorder, 2)
    recorder.close()
    assert read(tmp_path / "take.mcap") == [0, 1]


def test_an_endless_take_removes_its_oldest_parts_and_no_others(tmp_path: Path) -> None:
    (tmp_path / "precious.mcap").write_bytes(b"precious")
    recorder = take(tmp_path / "take.mcap", max_part_bytes=20_000, endless=True, keep_bytes=100_000)
    assert all(recorder.offer(pair(n)) for n in range(100))
    recorder.close()
    status = recorder.status()
    assert status["pairs"] == 100 and status["removed_parts"] > 10
    files = sorted(tmp_path.glob("take*"))
    assert sum(file.stat().st_size for file in files) <= 100_000
    numbers = read(tmp_path / "take.mcap")  # by the name of its first part, which is gone
    assert numbers == list(range(numbers[0], 100)) and numbers[0] > 50
    assert (tmp_path / "precious.mcap").read_bytes() == b"precious"


def test_without_endless_nothing_is_removed(tmp_path: Path) -> None:
    recorder = take(tmp_path / "take.mcap", max_part_bytes=20_000, keep_bytes=1, keep_s=1e-9)
    assert all(recorder.offer(pair(n)) for n in range(40))
    recorder.close()
    assert read(tmp_path / "take.mcap") == list(range(40))


def test_an_endless_take_makes_room_when_the_disk_fills(tmp_path: Path) -> None:
    def free(directory: Path) -> int:
        return (3 << 20) - sum(file.stat().st_size for file in directory.iterdir())

    recorder = take(
        tmp_path / "take.mcap", max_part_bytes=100_000, endless=True, min_free_bytes=2 << 20, free_bytes=free
    )
    assert all(recorder.offer(pair(n)) for n in range(400))
    recorder.close()
    status = recorder.status()
    assert status["pairs"] == 400 and status["dropped"] == {} and "problem" not in status
    assert read(tmp_path / "take.mcap")[-1] == 399


@pytest.mark.parametrize("policy", ["chunk", "1s"])
@pytest.mark.parametrize("seed", range(3))
def test_after_a_power_cut_everything_up_to_the_last_sync_is_there(
    tmp_path: Path, disk: Disk, policy: str, seed: int
) -> None:
    recorder = take(tmp_path / "take.mcap", max_part_bytes=40_000, sync=policy)
    for number in range(30):
        assert recorder.offer(pair(number))
    written(recorder, 30)
    least = 29 if policy == "chunk" else 0
    wait_until(lambda: (recorder.status()["synced"]["up_to_sequence"] or 0) >= least)
    wait_until(lambda: recorder.status()["synced"]["up_to_sequence"] is not None)
    safe = recorder.status()["synced"]["up_to_sequence"]
    crashed = tmp_path / "crashed"
    crashed.mkdir()
    for file in tmp_path.glob("take*"):
        os.link(file, crashed / file.name)
    synced = dict(disk.synced)
    copies = tmp_path / "copies"
    shutil.copytree(crashed, copies)
    disk.synced = {(copies / f.name).stat().st_ino: synced.get(f.stat().st_ino, 0) for f in crashed.iterdir()}
    disk.power_cut(copies, np.random.default_rng(seed))
    numbers = read(copies / "take.mcap")
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= safe + 1
    if policy == "chunk":
        assert len(numbers) == 30
    recorder.close()


def test_a_part_that_the_disk_did_not_keep_gets_no_index(tmp_path: Path, disk: Disk) -> None:
    recorder = take(tmp_path / "take.mcap", sync="chunk")
    assert recorder.offer(pair(0))
    written(recorder, 1)
    real = disk._through

    def broken(name: str, call: Any) -> Any:
        def fail(*_: Any) -> None:
            raise OSError(5, "Input/output error")

        return fail if name == "fdatasync" else real(name, call)

    disk._through = broken  # type: ignore[method-assign]
    assert recorder.offer(pair(1))
    wait_until(lambda: recorder.status().get("pairs") == 2)
    assert recorder.offer(pair(2))
    wait_until(lambda: recorder.status().get("interruptions") == 1)
    disk._through = real  # type: ignore[method-assign]
    written(recorder, 3)
    recorder.close()
    assert recorder.status()["unsynced_pairs"] == 1
    assert (tmp_path / "take.mcap.partial").exists() and (tmp_path / "take_part002.mcap").exists()
    assert read(tmp_path / "take.mcap.partial") == [0, 1, 2]


@pytest.mark.parametrize("seed", range(4))
def test_any_sequence_of_faults_leaves_a_readable_take_and_true_counts(tmp_path: Path, disk: Disk, seed: int) -> None:
    rng = np.random.default_rng(seed)
    recorder = take(tmp_path / "take.mcap", queue=20, max_part_bytes=60_000, retry_s=0.005)
    offered = slowest_s = 0.0
    for _ in range(40):
        mode = rng.choice(["ok", "ok", "full", "io", "readonly", "gone", "hang"])
        disk.hang() if mode == "hang" else setattr(disk, "mode", mode)
        for _ in range(int(rng.integers(1, 12))):
            began = time.monotonic()
            recorder.offer(pair(int(offered)))
            slowest_s = max(slowest_s, time.monotonic() - began)
            offered += 1
        wait_until(lambda: recorder.status()["queued"] == 0 or disk.mode != "ok", 60)
        if mode == "hang":
            disk.heal()
    disk.heal()
    wait_until(lambda: recorder.status()["queued"] == 0 and "problem" not in recorder.status(), 60)
    recorder.close()
    status = recorder.status()
    assert status["pairs"] + sum(status["dropped"].values()) == offered
    assert slowest_s < 20.0
    first = next(iter(sorted(tmp_path.glob("take.mcap*"))))
    numbers = read(first)
    assert len(set(numbers)) == len(numbers)
    assert status["pairs"] - status.get("unsynced_pairs", 0) <= len(numbers) <= status["pairs"]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A real file system of 3 MB."""
    if os.geteuid() != 0:
        pytest.skip("mounting needs root")
    where = tmp_path / "disk"
    where.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "none", str(where)], capture_output=True).returncode:
        reason = "mounting is not permitted on this machine"
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)
    yield where
    while subprocess.run(["umount", "-l", str(where)], capture_output=True).returncode == 0:
        pass


def test_a_real_disk_runs_full_and_is_emptied(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(1 << 20))
    recorder = take(small_disk / "take.mcap", queue=2000, free_bytes=lambda _: 1 << 40)
    offered = 0
    while "problem" not in recorder.status():
        assert offered < 20_000
        assert recorder.offer(pair(offered))
        offered += 1
        wait_until(lambda: (status := recorder.status())["queued"] == 0 or "problem" in status)
    assert "No space left" in recorder.status()["problem"]
    ballast.unlink()
    written(recorder, offered)
    recorder.close()
    assert read(next(iter(sorted(small_disk.glob("take.mcap*"))))) == list(range(offered))


def test_a_real_disk_is_pulled_and_the_take_waits_for_it_not_for_another(small_disk: Path) -> None:
    recorder = take(small_disk / "take.mcap", max_part_bytes=20_000, free_bytes=lambda _: 1 << 40)
    assert recorder.offer(pair(0))
    written(recorder, 1)
    aside = small_disk.with_name("aside")
    aside.mkdir()
    subprocess.run(["mount", "--bind", str(small_disk), str(aside)], check=True)
    try:
        subprocess.run(["umount", "-l", str(small_disk)], check=True)
        for number in range(1, 20):
            recorder.offer(pair(number))
        wait_until(lambda: "problem" in recorder.status())
        wait_until(lambda: "another disk" in recorder.status()["problem"])
        assert list(small_disk.iterdir()) == []
        subprocess.run(["mount", "--bind", str(aside), str(small_disk)], check=True)
        written(recorder, 20)
        recorder.close()
        assert recorder.status()["pairs"] == 20
        assert read(next(iter(sorted(small_disk.glob("take.mcap*"))))) == list(range(20))
    finally:
        subprocess.run(["umount", "-l", str(aside)], check=False)
