"""Time stamps on the host's clock, and frame numbers as triggers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.host_clocks import Clocks
from drivers.v4l2.timing import Sequence, realtime_of

CLOCKS = Clocks(monotonic_ns=5_000 * 10**9, realtime_ns=1_800_000_000 * 10**9)


@given(age_ns=st.integers(0, 9 * 10**9))
def test_stamps_of_either_clock_become_the_same_moment(age_ns: int) -> None:
    wanted = CLOCKS.realtime_ns - age_ns
    assert realtime_of(CLOCKS.monotonic_ns - age_ns, CLOCKS) == wanted
    assert realtime_of(CLOCKS.realtime_ns - age_ns, CLOCKS) == wanted


@given(stamp=st.sampled_from([0, 17, CLOCKS.monotonic_ns - 20 * 10**9, CLOCKS.monotonic_ns + 10**9, 2**62]))
def test_stamps_of_no_clock_are_not_believed(stamp: int) -> None:
    assert realtime_of(stamp, CLOCKS) is None


@given(
    start=st.sampled_from([0, 3, 31, 10**6, 2**32 - 5]),
    gaps=st.lists(st.integers(0, 50), max_size=40),
)
def test_triggers_count_frames_and_gaps_also_over_the_wrap(start: int, gaps: list[int]) -> None:
    sequence = Sequence()
    number, first = start, 0 if start < 32 else start
    trigger, lost = sequence.feed(number)
    assert trigger == (number - first) % 2**32 and lost == trigger
    total = lost
    for i, gap in enumerate(gaps):
        number = (number + 1 + gap) % 2**32
        trigger, missing = sequence.feed(number)
        total += missing
        assert missing == gap
        assert trigger == i + 1 + total


def test_a_decreasing_count_is_reported() -> None:
    sequence = Sequence()
    sequence.feed(100)
    assert sequence.feed(40)[1] == -1
    assert sequence.feed(40)[1] == -1
    assert sequence.feed(41) == ((41 - 100) % 2**32, 0)


def test_both_clocks_are_read_at_one_moment() -> None:
    a, b = Clocks.now(), Clocks.now()
    assert a.monotonic_ns <= b.monotonic_ns
