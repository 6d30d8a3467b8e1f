"""Laws of the trigger numbers: gaps stay gaps, whatever the camera's count does."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.numbering import TriggerNumbers

S = 10**9
taken = st.lists(st.integers(0, 200), min_size=1, max_size=50, unique=True).map(sorted)


@given(taken, st.sampled_from([0, 1]), st.integers(0, 15))
def test_a_count_that_begins_at_each_start_gives_the_trigger_itself(ids: list[int], first: int, lost: int) -> None:
    numbers = TriggerNumbers(first)
    ids = [lost + k - ids[0] for k in ids]
    assert [numbers.number(first + k, k * S) for k in ids] == ids
    assert numbers.gaps == ids[-1] + 1 - len(ids)
    assert not numbers.by_time


@given(taken, st.integers(1000, 10**9))
def test_a_count_that_goes_on_begins_at_nought(ids: list[int], begin: int) -> None:
    numbers = TriggerNumbers()
    assert [numbers.number(begin + k, k * S) for k in ids] == [k - ids[0] for k in ids]
    numbers.start()
    assert numbers.number(begin + ids[-1] + 1, S) == 0


def test_two_cameras_agree_after_a_restart_of_a_count_that_goes_on() -> None:
    numbers = TriggerNumbers()
    assert [numbers.number(k, k * S) for k in (0, 1, 2)] == [0, 1, 2]
    numbers.start()
    assert [numbers.number(k, k * S) for k in (5, 6, 8)] == [0, 1, 3]


def test_a_restarting_counter_reveals_a_lost_first_frame() -> None:
    numbers = TriggerNumbers()
    for first in (0, 0, 3):
        numbers.start()
        assert [numbers.number(first + k, k * S) for k in range(10)] == list(range(first, first + 10))


@given(taken)
def test_short_block_ids_of_gige_vision_wrap_to_one(steps: list[int]) -> None:
    numbers = TriggerNumbers(1)
    true = [65500 + k for k in sorted({0, *steps})]
    ids = [(k - 1) % 65535 + 1 for k in true]
    assert [numbers.number(i, k * S) for k, i in enumerate(ids)] == [k - true[0] for k in true]
    assert numbers.resets == 0


@given(taken)
def test_counts_wrap_at_32_bits(steps: list[int]) -> None:
    numbers = TriggerNumbers()
    true = [(1 << 32) - 100 + k for k in sorted({0, *steps})]
    assert [numbers.number(k % (1 << 32), k * S) for k in true] == [k - true[0] for k in true]


def test_a_counter_that_restarts_in_between_continues_by_one() -> None:
    numbers = TriggerNumbers()
    assert [numbers.number(k, 0) for k in (100, 101, 0, 1, 2)] == [0, 1, 2, 3, 4]
    assert numbers.resets == 1


@given(st.lists(st.integers(1, 3), min_size=5, max_size=20))
def test_without_a_counter_regular_times_reveal_the_gaps(steps: list[int]) -> None:
    for frame_id in (None, 0):
        numbers = TriggerNumbers()
        true = list(itertools.accumulate([0] + [1] * 10 + [k for step in steps for k in (step, 1, 1)]))
        found = [numbers.number(frame_id, k * S // 30) for k in true]
        assert found == true
        assert numbers.by_time


def test_without_a_count_irregular_frames_are_counted() -> None:
    numbers = TriggerNumbers()
    times = list(itertools.accumulate([7**k % 1000 + 1 for k in range(30)]))
    assert [numbers.number(None, t * S) for t in times] == list(range(30))


def test_a_count_that_moves_again_is_believed_again() -> None:
    numbers = TriggerNumbers()
    for k in range(6):
        numbers.number(0, k * S)
    assert numbers.by_time
    numbers.number(1, 6 * S)
    assert not numbers.by_time
