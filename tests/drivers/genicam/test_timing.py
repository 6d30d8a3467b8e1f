"""Exposure times of frames, by clocks and stamps that cameras may have."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.genicam.timing import Timing
from drivers.host_clocks import Clocks


class Features:
    """A camera whose clock is that of the host, but for ``ahead_s``."""

    def __init__(self, ahead_s: int = 0) -> None:
        self.ahead_s = ahead_s
        self.latched = 0

    def find(self, name: str) -> Any:
        return None if name == "TimestampTickFrequency" else self

    def execute(self, _: str) -> None:
        self.latched = time.monotonic_ns() + self.ahead_s * 10**9

    def read(self, name: str) -> int | None:
        return self.latched if name == "TimestampLatchValue" else None


class WithoutClock:
    """A camera without a clock."""

    def find(self, _: str) -> None:
        return None

    def read(self, _: str) -> None:
        return None


def timing_of(features: Any) -> Timing:
    return Timing(features)


@pytest.mark.parametrize("ahead_s", [-3600, 3600])
def test_a_clock_that_is_not_the_one_of_the_stamps_is_found_out(ahead_s: int) -> None:
    timing = timing_of(Features(ahead_s))
    timing.follow(time.monotonic_ns())
    for _ in range(12):
        now = time.monotonic_ns()
        buffer: Any = SimpleNamespace(timestamp_ns=time.monotonic_ns())
        found = timing.exposure(buffer, now, 100.0)
        timing.follow(time.monotonic_ns())
        assert abs(found.t_ns - now) < 50_000_000
    assert not timing.latches
    assert timing.clock.ready and not timing.clock.latched


def test_a_clock_of_the_day_that_is_set_does_not_touch_what_is_known_of_the_camera(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    timing, real = timing_of(Features()), time.time_ns
    for step_s in (0, 3600, -7200):
        monkeypatch.setattr(time, "time_ns", lambda step_s=step_s: real() + step_s * 10**9)
        timing.follow(time.monotonic_ns())
        clocks = Clocks.now()
        buffer: Any = SimpleNamespace(timestamp_ns=clocks.monotonic_ns - 10**6)
        found = timing.exposure(buffer, clocks.monotonic_ns, 0.0)
        assert abs(clocks.to_realtime_ns(found.t_ns) - (clocks.realtime_ns - 10**6)) < 1_000_000
    assert timing.clock.resets == 0 and timing.latches


def test_a_camera_without_stamps_or_with_noughts_for_them_is_timed_by_arrival() -> None:
    timing = timing_of(WithoutClock())
    assert not timing.latches
    buffer: Any = SimpleNamespace(timestamp_ns=0, timestamp=0)
    for _ in range(2):
        found = timing.exposure(buffer, 10**18, 250.0)
        assert (found.t_device_ns, found.t_ns) == (None, 10**18 - 250_000)
    assert timing.without_stamp == 2
