"""Laws of the clock model, on simulated clocks: what it maps is true within what it admits, whatever happens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.device_clock import DeviceClock, period_ns

MS = 1_000_000
S = 1_000_000_000
START = 1_790_000_000 * S


@dataclass
class Crystal:
    """A device's clock: what it shows at a time of the host."""

    offset_ns: int
    ppm: float

    def shows(self, host_ns: int) -> int:
        return self.offset_ns + round((host_ns - START) * (1 + self.ppm * 1e-6))


drifts = st.floats(-100, 100)
offsets = st.integers(0, 10**18)
seeds = st.integers(0, 2**32 - 1)


def latched(
    crystal: Crystal, seconds: float, rng: np.random.Generator, clock: DeviceClock | None = None
) -> DeviceClock:
    """Latches of random round trips (some long), about two a second."""
    clock = clock or DeviceClock()
    for k in range(int(seconds * 2.5)):
        before = START + k * 400 * MS + int(rng.integers(0, 50 * MS))
        there, back = rng.exponential(0.2 * MS, 2) + 0.02 * MS
        if rng.random() < 0.1:
            back += 80 * MS
        clock.latch(before, crystal.shows(before + round(there)), before + round(there + back))
    return clock


@settings(max_examples=30, deadline=None)
@given(drifts, offsets, seeds, st.floats(1, 100))
def test_with_latches_times_are_true_within_the_uncertainty(ppm: float, offset: int, seed: int, seconds: float) -> None:
    rng = np.random.default_rng(seed)
    crystal = Crystal(offset, ppm)
    clock = latched(crystal, seconds, rng)
    now = START + int(seconds * S)
    for ago in (0, 20 * MS, 500 * MS):
        device = crystal.shows(now - ago)
        error = abs(clock.to_host_ns(device) - (now - ago))
        assert error <= clock.uncertainty_ns(device) + 100_000
        assert error < 1 * MS or seconds < 5, "two long round trips may be all there is at first"
    assert clock.resets == 0
    assert clock.latched


@settings(max_examples=30, deadline=None)
@given(drifts, offsets, seeds)
def test_the_drift_is_found(ppm: float, offset: int, seed: int) -> None:
    clock = latched(Crystal(offset, ppm), 40, np.random.default_rng(seed))
    assert clock.drift_ppm() == pytest.approx(-ppm, abs=8)


def arrivals(
    crystal: Crystal, seconds: float, rng: np.random.Generator, clock: DeviceClock, *, stall_at: float | None = None
) -> float:
    """30 frames a second with random delays of 3 ms and more; returns the worst error of the last second."""
    stall = None if stall_at is None else START + int(stall_at * S)
    errors = []
    count = int(seconds * 30)
    arrived = 0
    for k in range(count):
        exposed = START + k * S // 30
        arrived = max(arrived + 1, exposed + round(3 * MS + rng.exponential(1 * MS)))
        if stall is not None and stall <= arrived < stall + 2 * S:
            arrived = stall + 2 * S
        device = crystal.shows(exposed)
        clock.arrival(device, arrived, delay_ns=2 * MS)
        if k > count - 30:
            errors.append(clock.to_host_ns(device) - exposed)
    return max(abs(error) for error in errors) / MS


@settings(max_examples=20, deadline=None)
@given(drifts, offsets, seeds, st.floats(4, 90))
def test_arrivals_alone_lead_to_the_shortest_delay(ppm: float, offset: int, seed: int, seconds: float) -> None:
    clock = DeviceClock()
    worst = arrivals(Crystal(offset, ppm), seconds, np.random.default_rng(seed), clock)
    assert worst < 1.0 + 0.6, "1 ms of the delay is unknown by construction"
    assert clock.resets == 0


@settings(max_examples=30, deadline=None)
@given(drifts, seeds, st.floats(5, 25))
def test_a_stall_of_two_seconds_moves_nothing(ppm: float, seed: int, at: float) -> None:
    clock = DeviceClock()
    worst = arrivals(Crystal(10**15, ppm), 30, np.random.default_rng(seed), clock, stall_at=at)
    assert worst < 1.6
    assert clock.resets == 0


def test_a_late_first_frame_is_corrected_by_the_second() -> None:
    clock = DeviceClock()
    clock.arrival(10**15, START + 11 * MS)
    clock.arrival(10**15 + 33 * MS, START + 36 * MS)
    assert clock.to_host_ns(10**15 + 33 * MS) == START + 36 * MS
    assert clock.resets == 0


@pytest.mark.parametrize("jump_s", [-1000, -0.2, 0.2, 1000])
def test_a_reset_clock_is_determined_again_from_latches(jump_s: float) -> None:
    rng = np.random.default_rng(1)
    clock = latched(Crystal(10**15, 40), 20, rng)
    moved = Crystal(10**15 + round(jump_s * S) + 21 * S, 40)
    latched(moved, 4, rng, clock)
    assert clock.resets == 1
    assert abs(clock.to_host_ns(moved.shows(START + 4 * S)) - (START + 4 * S)) < MS


@pytest.mark.parametrize("jump_s", [-1000.0, 0.05, 1000.0])
def test_a_reset_clock_is_determined_again_from_arrivals(jump_s: float) -> None:
    clock, rng = DeviceClock(), np.random.default_rng(2)
    for k in range(600):
        exposed = START + k * S // 30
        shown = exposed - START + 10**13 + (round(jump_s * S) if k >= 300 else 0)
        clock.arrival(shown, exposed + round(3 * MS + rng.exponential(MS)))
        if k >= 310:
            assert abs(clock.to_host_ns(shown) - exposed) < 5 * MS
    assert clock.resets == 1


def test_a_clock_set_back_a_little_is_found_out_after_some_seconds() -> None:
    clock, rng = DeviceClock(), np.random.default_rng(3)
    for k in range(900):
        exposed = START + k * S // 30
        shown = exposed - START + 10**13 - (round(0.03 * S) if k >= 300 else 0)
        clock.arrival(shown, exposed + round(3 * MS + rng.exponential(MS)))
    assert clock.resets == 1
    assert abs(clock.to_host_ns(shown) - exposed) < 5 * MS


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_time_never_runs_backwards_between_two_frames(seed: int) -> None:
    rng, clock, crystal = np.random.default_rng(seed), DeviceClock(), Crystal(10**12, 60)
    last = 0
    for k in range(600):
        exposed = START + k * S // 30
        clock.arrival(crystal.shows(exposed), exposed + round(3 * MS + rng.exponential(2 * MS)))
        mapped = clock.to_host_ns(crystal.shows(exposed))
        assert mapped > last
        last = mapped


def test_uncertainty_grows_with_the_distance_and_nothing_is_known_at_first() -> None:
    clock = DeviceClock()
    assert not clock.ready
    assert clock.drift_ppm() == 0
    for ask in (clock.to_host_ns, clock.uncertainty_ns):
        with pytest.raises(ValueError, match="no observation"):
            ask(0)
    clock.latch(START, 5 * S, START + 2 * MS)
    assert clock.ready
    assert clock.to_host_ns(5 * S) == START + MS
    assert MS <= clock.uncertainty_ns(5 * S) < clock.uncertainty_ns(60 * S)


def test_the_shortest_round_trip_of_a_second_counts() -> None:
    clock = DeviceClock()
    for trip in (9 * MS, 1 * MS, 30 * MS):
        clock.latch(START, 5 * S, START + trip)
    assert clock.uncertainty_ns(5 * S) <= MS
    assert clock.to_host_ns(5 * S) == START + MS // 2


@settings(max_examples=60, deadline=None)
@given(seeds, st.floats(0.005, 1), st.lists(st.integers(1, 4), min_size=4, max_size=15))
def test_regular_events_have_a_period_holes_or_not(seed: int, period_s: float, steps: list[int]) -> None:
    rng = np.random.default_rng(seed)
    usual = round(period_s * S)
    steps = [1] * (2 * len(steps)) + steps
    times = np.cumsum([0, *steps]) * usual + np.round(rng.uniform(-0.02, 0.02, len(steps) + 1) * usual).astype(np.int64)
    found = period_ns([int(t) for t in times])
    assert found == pytest.approx(usual, rel=0.05)


def test_irregular_events_have_none() -> None:
    rng = np.random.default_rng(5)
    assert period_ns([int(t) for t in np.cumsum(rng.exponential(S, 16))]) is None
    assert period_ns([1, 2, 3]) is None
    assert period_ns([5, 5, 5, 5, 5]) is None
