"""The watchdog's decision: a thread that hangs is found in time, one that gets no processor is not blamed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from daemon.bootstrap.systemd.watchdog import STUCK_S, Watchdog
from daemon.common.heartbeat import Heartbeat
from daemon.common.processor_share import ProcessorShare, ProcessorTimes

SECOND = 1_000_000_000
STARVED = {"ran": 0.25, "waited": 1.75, "others": 1e6}  # an eighth of what it needs
ALONE = {"ran": 0.25}
OWN_LOAD = {"ran": 2.0, "waited": 3.0}
SLIGHT = {"ran": 0.5, "waited": 0.04, "others": 1.4}


class Rig:
    """A service whose time and processor times the test advances; the main loop turns every 0.1 s."""

    def __init__(self) -> None:
        self.now_ns = self.ran = self.waited = self.others = 0
        beats = {name: Heartbeat(self.monotonic_ns) for name in ("pipeline", "left", "right")}
        self.pipeline, self.left = beats["pipeline"], beats["left"]
        self.worker = SimpleNamespace(heartbeat=self.pipeline, finished=0, waiting=0)
        self.processor_share = ProcessorShare(self.monotonic_ns, self.times)
        self.cameras = {side: SimpleNamespace(heartbeat=beats[side]) for side in ("left", "right")}
        self.router = SimpleNamespace(sinks={})
        self.clock = self
        self.watchdog = Watchdog(self)  # type: ignore[arg-type]

    def monotonic_ns(self) -> int:
        return self.now_ns

    def times(self) -> ProcessorTimes:
        return ProcessorTimes({1: self.ran}, {1: self.waited}, self.ran + self.others)

    def tick(self, *, ran: float = 0.0, waited: float = 0.0, others: float = 0.0) -> str:
        self.now_ns += SECOND // 10
        self.ran += round(ran * SECOND / 10)
        self.waited += round(waited * SECOND / 10)
        self.others += round(others * SECOND / 10)
        self.processor_share.tick()
        return self.watchdog.problem()

    def seconds_to_a_problem(self, load: dict[str, float], most: float = 400.0) -> float:
        """How long nothing is found, at most ``most`` seconds."""
        for turn in range(round(10 * most)):
            if self.tick(**load):
                return turn / 10
        return most


@pytest.mark.parametrize("load", [ALONE, OWN_LOAD, SLIGHT, {}], ids=["alone", "own load", "slight load", "asleep"])
def test_a_thread_that_hangs_is_found_at_its_deadline(load: dict[str, float]) -> None:
    rig = Rig()
    for _ in range(50):
        rig.tick(**load)
    rig.left.expect(10.0)
    assert 9.9 <= rig.seconds_to_a_problem(load) <= 10.2
    assert rig.watchdog.problem() == "camera left does not answer"


def test_a_thread_that_gets_an_eighth_of_the_processor_time_has_eight_times_as_long() -> None:
    rig = Rig()
    for _ in range(50):
        rig.tick(**STARVED)
    rig.pipeline.expect(10.0)
    assert rig.seconds_to_a_problem(STARVED) == pytest.approx(80.0, abs=2.0)


def test_time_that_was_lost_before_a_turn_does_not_extend_it() -> None:
    rig = Rig()
    for _ in range(600):
        rig.tick(**STARVED)
    for _ in range(50):
        rig.tick(**ALONE)
    rig.pipeline.expect(10.0)
    assert 9.9 <= rig.seconds_to_a_problem(ALONE) <= 10.2


def test_a_thread_that_turns_slowly_under_load_is_never_blamed() -> None:
    rig = Rig()
    for turn in range(6000):
        if turn % 600 == 0:  # a turn of a minute: 7.5 s of processor time
            rig.pipeline.expect(10.0)
        assert rig.tick(**STARVED) == ""


def test_waiting_pairs_count_the_same_time() -> None:
    for load, seconds in ((ALONE, STUCK_S), (STARVED, 8 * STUCK_S)):
        rig = Rig()
        rig.worker.waiting = 1
        assert rig.seconds_to_a_problem(load) == pytest.approx(seconds, rel=0.03)
        assert "none was measured" in rig.watchdog.problem()


def test_a_process_that_was_stopped_is_not_blamed_when_it_goes_on() -> None:
    rig = Rig()
    rig.tick(**ALONE)
    rig.left.expect(10.0)
    rig.now_ns += 60 * SECOND
    assert rig.tick(**ALONE) == ""
    assert rig.seconds_to_a_problem(ALONE) <= 10.0
