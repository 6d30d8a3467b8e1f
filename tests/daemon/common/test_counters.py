"""Counting, rates, percentiles and the latest-wins queue."""

from __future__ import annotations

import threading

import pytest

from daemon.common.counters import Counters, Percentiles, Rate
from daemon.common.latest_wins_queue import LatestWinsQueue


def test_counts_from_many_threads_add_up() -> None:
    counters = Counters()
    threads = [threading.Thread(target=lambda: [counters.add("a") for _ in range(1000)]) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert counters.snapshot() == {"a": 8000} and counters["b"] == 0


@pytest.mark.parametrize("seconds", [1, 2, 10])
def test_a_steady_rate_is_reported_from_the_first_second_on(seconds: int) -> None:
    rate = Rate(3.0)
    for i in range(20 * seconds + 1):
        rate.note(i * 50_000_000)
    assert rate.per_second(seconds * 1_000_000_000) == pytest.approx(20, rel=0.02)


def test_a_rate_falls_to_nothing_when_events_end() -> None:
    rate = Rate(3.0)
    rate.note(0)
    assert rate.per_second(10**10) == 0 and Rate().per_second(5) == 0


def test_percentiles_are_those_of_the_last_values() -> None:
    values = Percentiles(2000)
    assert values.summary() == {}
    values.note(7.0)
    assert set(values.summary().values()) == {7.0}
    for i in range(10_000):
        values.note(float(i * 7919 % 10_000))  # every number once, the last 2000 in no order
    kept = sorted(float(i * 7919 % 10_000) for i in range(8000, 10_000))
    expected = {"p50": kept[1000], "p95": kept[1900], "p99": kept[1980], "p999": kept[1998], "max": kept[-1]}
    assert values.summary() == expected | {"last": 9999 * 7919 % 10_000}


def test_the_latest_wins_and_what_is_pushed_out_is_returned() -> None:
    box: LatestWinsQueue[int] = LatestWinsQueue(2)
    assert [box.put(i) for i in range(4)] == [None, None, 0, 1]
    assert box.get(0) == 2 and len(box) == 1
    assert box.close() == [3]
    assert box.put(9) == 9 and box.get(0) is None
