"""The garbage collector runs only when it is called."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from daemon.live.processing.gc_control import GcControl, GcPauses


class Ring:
    def __init__(self) -> None:
        self.me = self


@pytest.fixture
def garbage() -> Iterator[GcControl]:
    made = GcControl()
    made.take_over(0.0)
    yield made
    made.release()
    assert gc.isenabled() and gc.get_freeze_count() == 0


@pytest.fixture
def collections() -> Iterator[list[int]]:
    """Generations that were collected, in order."""
    seen: list[int] = []

    def note(phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            seen.append(info["generation"])

    gc.callbacks.append(note)  # type: ignore[arg-type]
    yield seen
    gc.callbacks.remove(note)  # type: ignore[arg-type]


def litter(count: int) -> weakref.ref[Ring]:
    rings = [Ring() for _ in range(count)]
    return weakref.ref(rings[-1])


def test_nothing_is_collected_by_itself(garbage: GcControl, collections: list[int]) -> None:
    lost = litter(50_000)
    assert garbage and collections == [] and lost() is not None


def test_the_young_are_collected_between_pairs_whether_idle_or_not(garbage: GcControl, collections: list[int]) -> None:
    lost = litter(5000)
    garbage.between_pairs(1.0, idle=False)
    assert collections == [0] and lost() is None
    garbage.between_pairs(1.1, idle=False)
    assert collections == [0]


def test_everything_is_collected_only_when_idle_unless_long_overdue(garbage: GcControl, collections: list[int]) -> None:
    for second in range(59, 600, 60):
        garbage.between_pairs(float(second), idle=False)
    assert collections == []
    garbage.between_pairs(600.0, idle=True)
    assert collections == [2]
    garbage.between_pairs(600.0 + 59, idle=True)
    assert collections == [2]
    garbage.between_pairs(600.0 + 700, idle=False)
    assert collections == [2, 2]


def test_a_long_run_collects_the_middle_generation_too(garbage: GcControl, collections: list[int]) -> None:
    for _ in range(20):
        litter(3000)
        garbage.between_pairs(1.0, idle=False)
    assert collections.count(1) == 2 and collections.count(2) == 0


def test_every_pause_is_counted_with_its_length(garbage: GcControl) -> None:
    ms = iter((0, 3, 100, 101))
    pauses = GcPauses(lambda: next(ms) * 1_000_000)
    gc.collect()
    pauses.start()
    gc.collect()
    garbage.take_over(0.0)
    pauses.stop()
    pauses.stop()
    gc.collect()
    assert pauses.summary() == {"count": 2, "total_ms": 4.0, "max_ms": 3.0}


def test_what_was_there_is_frozen_and_may_go_after_the_next_hold(garbage: GcControl) -> None:
    ring = Ring()
    lost = weakref.ref(ring)
    garbage.take_over(1.0)
    assert gc.get_freeze_count() > 0
    del ring
    gc.collect()
    assert lost() is not None
    garbage.take_over(2.0)
    assert lost() is None
