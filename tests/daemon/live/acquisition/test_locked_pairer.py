"""The pairer shared by two camera threads: order, delivery one at a time, and independence of a slow consumer."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest

from daemon.common.clock import SystemClock
from daemon.common.counters import Counters
from daemon.live.acquisition.locked_pairer import MAX_EVENTS, LockedPairer
from daemon.live.acquisition.pairing_events import PairingSettings
from daemon.live.items import Pair
from drivers.protocols import Frame, Side
from tools.waiting import wait_until

PERIOD_NS = 10_000_000
IMAGE = np.zeros((2, 2), np.uint8)


def frame(side: Side, number: int) -> Frame:
    return Frame(side, number, number * PERIOD_NS, number * PERIOD_NS, "mono8", IMAGE)


def pairer_of(paired: Callable[[Pair], object]) -> tuple[LockedPairer, Counters]:
    drops, settings = Counters(), PairingSettings(max_wait_ns=10**12)
    return LockedPairer(settings, paired=paired, unpaired=lambda _: None, drops=drops, clock=SystemClock()), drops


def run(threads: list[threading.Thread]) -> None:
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()


@pytest.mark.parametrize("slow", ["left", "right"])
def test_a_slow_consumer_in_one_cameras_thread_does_not_delay_the_other_cameras_thread(slow: Side) -> None:
    """In the slow camera's thread the consumer of each pair waits until the other camera has delivered two frames more.

    That could never happen if the other thread had to wait for the consumer.
    """
    count, ahead = 300, 4
    received = {"left": 0, "right": 0}
    delivered: list[int] = []
    inside = threading.Lock()

    def paired(pair: Pair) -> None:
        assert inside.acquire(blocking=False), "two pairs are delivered at the same time"
        try:
            if threading.current_thread().name == slow:
                least = min(pair.seq + 2, count)
                wait_until(lambda: received[fast] >= least, 30, "frames of the other camera", poll_s=0.0001)
            delivered.append(pair.seq)
        finally:
            inside.release()

    pairer, drops = pairer_of(paired)
    fast: Side = "right" if slow == "left" else "left"

    def camera(side: Side) -> None:
        other: Side = "right" if side == "left" else "left"
        for number in range(count):
            # The fast camera is ahead, so that pairs are completed, and delivered, by the slow one.
            least = number - ahead if side == fast else number + 1
            wait_until(lambda least=least: received[other] >= least, 30, "the other camera", poll_s=0.0001)  # type: ignore[misc]
            pairer.receive(frame(side, number))
            received[side] += 1

    run([threading.Thread(target=camera, args=(side,), name=side) for side in received])
    pairer.flush()
    assert delivered == list(range(count)) and pairer.pairs == count
    assert not drops.snapshot()


def test_events_beyond_the_limit_are_dropped_and_counted_while_a_consumer_hangs() -> None:
    hanging, resume, delivered = threading.Event(), threading.Event(), []

    def paired(pair: Pair) -> None:
        hanging.set()
        assert resume.wait(60)
        delivered.append(pair.seq)

    pairer, drops = pairer_of(paired)
    count = MAX_EVENTS + 20

    def cameras(numbers: range) -> None:
        for number in numbers:
            for side in ("left", "right"):
                pairer.receive(frame(side, number))

    hung = threading.Thread(target=cameras, args=(range(3),))
    hung.start()
    assert hanging.wait(60)
    cameras(range(3, count))  # returns although the consumer hangs
    assert pairer.outcomes("left") == {"paired": count, "waiting": 0}
    resume.set()
    hung.join(60)
    pairer.flush()
    dropped = drops["pairs_delivery_busy"]
    assert delivered == sorted(delivered) and len(delivered) + dropped == count and dropped > 0
    assert pairer.pairs == len(delivered)


def test_flush_returns_when_everything_is_delivered() -> None:
    entered, resume, delivered = threading.Event(), threading.Event(), []

    def paired(pair: Pair) -> None:
        entered.set()
        assert resume.wait(60)
        delivered.append(pair.seq)

    pairer, _ = pairer_of(paired)
    for number in range(2):
        for side in ("left", "right"):
            pairer.receive(frame(side, number))

    def third() -> None:
        for side in ("left", "right"):
            pairer.receive(frame(side, 2))

    threads = [threading.Thread(target=third), threading.Thread(target=pairer.flush)]
    threads[0].start()
    assert entered.wait(60)
    threads[1].start()
    threads[1].join(0.1)
    assert threads[1].is_alive() and not delivered
    resume.set()
    for thread in threads:
        thread.join(60)
    assert delivered == [0, 1, 2]
