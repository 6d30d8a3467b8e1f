"""The processor time that other programs take, from injected times and on this machine."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from daemon.common.processor_share import ProcessorShare, ProcessorTimes, read_processor_times

SECOND = 1_000_000_000


@dataclass
class Machine:
    """A clock and the processor times of one process with one thread, advanced by the test."""

    now_ns: int = 0
    ran: int = 0
    waited: int = 0
    others: int = 0

    def read(self) -> ProcessorTimes:
        return ProcessorTimes({1: self.ran}, {1: self.waited}, self.ran + self.others)

    def share(self) -> ProcessorShare:
        return ProcessorShare(lambda: self.now_ns, self.read)

    def live(
        self, share: ProcessorShare, seconds: float, *, ran: float = 0.0, waited: float = 0.0, others: float = 0.0
    ) -> None:
        """Let time pass in ticks of 0.1 s; the rest are seconds per second."""
        for _ in range(round(10 * seconds)):
            self.now_ns += SECOND // 10
            self.ran += round(ran * SECOND / 10)
            self.waited += round(waited * SECOND / 10)
            self.others += round(others * SECOND / 10)
            share.tick()


def test_a_process_that_waits_for_nothing_loses_nothing() -> None:
    machine = Machine()
    share = machine.share()
    machine.live(share, 20, ran=0.5, others=1.5)
    assert (share.lost_ns, share.share, share.scarce) == (0, 1.0, False)


def test_waiting_behind_the_threads_of_the_same_process_loses_nothing() -> None:
    machine = Machine()
    share = machine.share()
    machine.live(share, 20, ran=2.0, waited=5.0)
    assert (share.lost_ns, share.share) == (0, 1.0)


def test_what_other_programs_take_is_lost_in_proportion() -> None:
    machine = Machine()
    share = machine.share()
    machine.live(share, 20, ran=0.25, waited=1.75, others=1_000_000.0)
    assert share.share == pytest.approx(1 / 8, rel=1e-3) and share.scarce
    assert share.lost_ns / SECOND == pytest.approx(20 * 7 / 8, abs=1.1)  # all but the first second's part
    assert share.as_dict()["share"] == 0.125
    machine.live(share, 10, ran=0.25)
    assert share.share == 1.0 and not share.scarce


def test_no_more_is_lost_than_the_threads_waited_together() -> None:
    machine = Machine()
    share = machine.share()
    machine.live(share, 20, ran=0.001, waited=0.1, others=2.0)
    assert share.lost_ns / SECOND == pytest.approx(2.0, abs=0.2)


def test_a_thread_that_hangs_is_found_however_busy_the_machine_is() -> None:
    machine = Machine()
    share = machine.share()
    machine.live(share, 100, ran=0.0, waited=50.0, others=2.0)
    assert share.lost_ns <= 95.1 * SECOND


def test_a_process_that_was_stopped_has_lost_that_time() -> None:
    machine = Machine()
    share = machine.share()
    machine.now_ns += 8 * SECOND
    share.tick()
    assert share.lost_ns == 7 * SECOND


def test_a_system_that_does_not_count_loses_nothing() -> None:
    now_ns = [0]
    share = ProcessorShare(lambda: now_ns[0], lambda: None)
    for _ in range(100):
        now_ns[0] += SECOND // 10
        share.tick()
    assert (share.lost_ns, share.share) == (0, 1.0)


def test_children_are_counted() -> None:
    with busy(1) as (child,):
        before = read_processor_times()
        if before is None:
            pytest.skip("this kernel does not count the waits of threads")
        assert child.pid in before.ran and threading.get_native_id() in before.ran


@pytest.mark.alone
def test_busy_programs_are_noticed_within_seconds_and_their_end_too() -> None:
    if read_processor_times() is None:
        pytest.skip("this kernel does not count the waits of threads")
    stop = threading.Event()
    worker = threading.Thread(target=lambda: [sum(range(1000)) for _ in iter(stop.is_set, True)])
    worker.start()
    try:
        with strangers(16):
            share = ProcessorShare()
            watch(share, 10.0, lambda: share.scarce)
            assert share.scarce and share.lost_ns > SECOND
        watch(share, 10.0, lambda: not share.scarce)
        assert not share.scarce
    finally:
        stop.set()
        worker.join()


def watch(share: ProcessorShare, most_s: float, until: object) -> None:
    end_s = time.monotonic() + most_s
    while time.monotonic() < end_s and not until():  # type: ignore[operator]
        share.tick()
        time.sleep(0.1)


@contextmanager
def busy(count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Busy children of this process."""
    made = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield made
    finally:
        for process in made:
            process.kill()
            process.wait()


@contextmanager
def strangers(count: int) -> Iterator[None]:
    """Busy processes that are no children of this one, as other programs are."""
    code = (
        "import subprocess, sys; run = [sys.executable, '-c', 'while True: pass']; "
        "made = [subprocess.Popen(run, stdout=-3, stderr=-3) "
        f"for _ in range({count})]; print(*(p.pid for p in made), flush=True)"
    )
    text = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    try:
        yield
    finally:
        subprocess.run(["kill", "-9", *text.split()], check=False)
