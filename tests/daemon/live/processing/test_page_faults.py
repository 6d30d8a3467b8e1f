"""Page faults are counted by pair and in all, of the process and of the calling thread."""

from __future__ import annotations

import mmap
import resource
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from daemon.live.processing.page_faults import PageFaults

PAGES = 500


@pytest.fixture
def memory() -> Iterator[mmap.mmap]:
    """Memory of which no page has been touched."""
    with mmap.mmap(-1, PAGES * mmap.PAGESIZE) as made:
        made.madvise(mmap.MADV_NOHUGEPAGE)
        yield made


def touch(memory: mmap.mmap) -> None:
    for page in range(PAGES):
        memory[page * mmap.PAGESIZE] = 1


def started() -> PageFaults:
    faults = PageFaults()
    faults.start()
    return faults


def test_nothing_is_reported_before_the_start() -> None:
    assert PageFaults().summary() == {}


def test_new_memory_faults_on_every_page_and_memory_that_was_used_does_not(memory: mmap.mmap) -> None:
    faults = started()
    with faults.pair():
        touch(memory)
    first = faults.summary()
    assert first["pair_last"] >= first["thread_last"] >= PAGES and first["minor_faults"] >= PAGES
    with faults.pair():
        touch(memory)
    again = faults.summary()
    assert again["thread_last"] < PAGES // 10 and again["pair_worst"] == first["pair_worst"]


def test_faults_of_other_threads_are_those_of_the_process_only(memory: mmap.mmap) -> None:
    faults = started()
    with faults.pair():
        other = threading.Thread(target=touch, args=(memory,))
        other.start()
        other.join()
    summary = faults.summary()
    assert summary["pair_last"] >= PAGES and summary["thread_last"] < PAGES // 2


def test_counts_never_decrease_and_pairs_are_part_of_them() -> None:
    faults, before, pairs = started(), {"minor_faults": 0.0, "major_faults": 0.0, "pair_worst": 0.0}, 0.0
    for size in (1, 40, 3, 0, 90):
        with faults.pair():
            kept = bytearray(size << 16)
        now = faults.summary()
        pairs += now["pair_last"]
        assert all(now[name] >= before[name] for name in before) and len(kept) == size << 16
        assert now["minor_faults"] + now["major_faults"] >= pairs
        before = {name: now[name] for name in before}


def test_faults_with_and_without_a_disk_are_added_for_a_pair() -> None:
    counts = {resource.RUSAGE_SELF: iter((10, 10, 17, 40)), resource.RUSAGE_THREAD: iter((0, 2))}

    def usage(who: int) -> Any:
        return SimpleNamespace(ru_minflt=next(counts[who]), ru_majflt=1 if who == resource.RUSAGE_SELF else 0)

    faults = PageFaults(usage)
    faults.start()
    with faults.pair():
        pass
    summary = faults.summary()
    del summary["python_blocks"]
    shares = ("last", "p50", "p99")
    assert summary == (
        {"minor_faults": 30, "major_faults": 0, "pair_worst": 7}
        | {f"pair_{share}": 7 for share in shares}
        | {f"thread_{share}": 2 for share in shares}
    )
