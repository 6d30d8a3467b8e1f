"""Overload: half the pixels when pairs are dropped, all of them again when there is room, and no swinging."""

from __future__ import annotations

import pytest

from daemon.live.processing.load_shedding import LoadShedding

FULL_MS, HALF_MS = 60.0, 20.0


class Rig:
    """A pipeline with a queue of one pair, simulated millisecond by millisecond."""

    def __init__(self, *, enabled: bool = True) -> None:
        self.overload = LoadShedding(enabled=enabled)
        self.now_ms, self.free_at_ms = 0, 0.0
        self.busy: tuple[float, int] | None = None
        self.waits = False
        self.drops = self.changes = 0

    def run(self, seconds: float, rate_hz: float, slowness: float = 1.0) -> None:
        period_ms = round(1000 / rate_hz)
        for _ in range(round(1000 * seconds)):
            self.now_ms += 1
            if self.now_ms % period_ms == 0:
                self.offer()
            self.work(slowness)

    def offer(self) -> None:
        self.overload.offered(self.now_ms * 10**6)
        if self.waits:
            self.drops += 1
            self.overload.dropped(self.now_ms * 10**6)
        self.waits = True

    def work(self, slowness: float) -> None:
        if self.busy is not None and self.now_ms >= self.free_at_ms:
            self.changes += self.overload.measured(*self.busy, self.now_ms * 10**6)
            self.busy = None
        if self.busy is None and self.waits:
            stride = self.overload.stride
            ms = slowness * (FULL_MS if stride == 1 else HALF_MS)
            self.busy, self.free_at_ms, self.waits = (ms, stride), self.now_ms + ms, False


def test_enough_time_never_changes_anything() -> None:
    rig = Rig()
    rig.run(20, rate_hz=15)
    assert rig.drops == rig.changes == 0 and rig.overload.stride == 1


def test_pairs_that_come_too_fast_are_measured_by_half_and_hardly_dropped() -> None:
    rig = Rig()
    rig.run(20, rate_hz=30)
    assert rig.overload.stride == 2
    assert rig.drops <= 5 and rig.changes == 1


def test_one_long_measurement_changes_nothing_however_many_pairs_it_costs() -> None:
    rig = Rig()
    rig.run(0.2, rate_hz=10, slowness=15)
    rig.run(10, rate_hz=10)
    assert rig.drops > 5 and rig.changes == 0


def test_without_leave_pairs_are_skipped_for_ever() -> None:
    rig = Rig(enabled=False)
    rig.run(20, rate_hz=30)
    assert rig.overload.stride == 1 and rig.changes == 0 and rig.drops > 100


def test_a_slower_trigger_brings_the_full_image_back_after_seconds() -> None:
    rig = Rig()
    rig.run(10, rate_hz=30)
    rig.run(2, rate_hz=10)
    assert rig.overload.stride == 2
    rig.run(4, rate_hz=10)
    assert rig.overload.stride == 1 and rig.changes == 2


def test_a_machine_that_was_slowed_down_for_a_while_comes_back() -> None:
    rig = Rig()
    rig.run(10, rate_hz=12)
    assert rig.overload.stride == 1
    rig.run(10, rate_hz=12, slowness=2.0)
    assert rig.overload.stride == 2
    rig.run(10, rate_hz=12)
    assert rig.overload.stride == 1


@pytest.mark.parametrize("rate_hz", [14.0, 16.0, 17.0, 20.0, 25.0])
def test_it_does_not_swing(rate_hz: float) -> None:
    rig = Rig()
    rig.run(60, rate_hz=rate_hz)
    assert rig.changes <= 1
