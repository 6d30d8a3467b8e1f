"""The common trigger count never assigns a number twice, across restarts, late pairs and the wrap of 32 bits."""

from __future__ import annotations

import pytest

from daemon.live.acquisition.trigger_count import TriggerCount
from drivers.protocols import TRIGGER_MODULUS

PERIOD_NS = 33_000_000


def run(count: TriggerCount, first: int, pairs: int, t_ns: int) -> list[int]:
    """Assign numbers to pairs whose cameras count from ``first``; return the assigned numbers."""
    assigned, offset = [], 0
    for k in range(pairs):
        number = (first + k + offset) % TRIGGER_MODULUS
        offset += count.move(number, t_ns + k * PERIOD_NS, ())
        number = (first + k + offset) % TRIGGER_MODULUS
        count.assigned(number, t_ns + k * PERIOD_NS, paired=True)
        assigned.append(number)
    return assigned


@pytest.mark.parametrize("first", [0, 7, TRIGGER_MODULUS - 3])
def test_numbers_are_kept_while_the_cameras_count(first: int):
    count = TriggerCount()
    assert run(count, first, 10, 0) == [(first + k) % TRIGGER_MODULUS for k in range(10)]
    assert count.counter_restarts == 0


@pytest.mark.parametrize("restarted_at", [0, 3])
def test_after_a_restart_the_count_goes_on_behind_the_highest_number(restarted_at: int):
    count = TriggerCount()
    before = run(count, 100, 20, 0)
    after = run(count, restarted_at, 20, 10**12)
    assert after == [before[-1] + 1 + k for k in range(20)]
    assert count.counter_restarts == 1


def test_frames_that_wait_leave_a_gap_for_their_numbers():
    count = TriggerCount()
    before = run(count, 100, 5, 0)
    assert count.move(6, 10**12, (4, 5)) == before[-1] + 1 + 2 - 6
    assert count.counter_restarts == 1


def test_a_pair_that_is_late_is_no_restart():
    count = TriggerCount()
    run(count, 0, 10, 0)
    assert count.move(7, 7 * PERIOD_NS, ()) == 0
    assert count.counter_restarts == 0
