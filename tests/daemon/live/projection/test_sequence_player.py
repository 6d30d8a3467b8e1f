"""Sets of a driven projector in virtual time: every pair of a set shows its image, or there is no set."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from daemon.common.errors import DaemonError
from daemon.live.items import ImageSet, Pair
from daemon.live.projection import sequence_player as driver_module
from daemon.live.projection.confirmed_capture import ConfirmedCapture, settling_ns
from daemon.live.projection.sequence_player import SequencePlayer
from drivers.errors import DriverError
from tests.daemon.live.projection.virtual_time import MS, Bench, image, level
from tools.waiting import wait_until

LEVELS = [10, 60, 110, 160, 210]


class Played:
    """A driver over a bench, and what came of it."""

    def __init__(self, bench: Bench, *, most: int = 20) -> None:
        self.bench, self.most = bench, most
        self.sets: list[ImageSet] = []
        self.seen: list[Pair] = []
        self.dropped = 0
        self.driver = SequencePlayer(
            self._capture, confirmed=self.seen.append, complete=self._complete, dropped=self._drop
        )
        self.before_get: Callable[[], None] = lambda: None

    def _capture(self, _: object, cancelled: Callable[[], bool]) -> ConfirmedCapture:
        info = self.bench.open()
        settle_ns = settling_ns(info, tolerance_ns=2 * MS)
        return ConfirmedCapture(self.bench, info, self, clock=self.bench, settle_ns=settle_ns, cancelled=cancelled)

    def get(self, timeout_s: float) -> Pair | None:
        self.before_get()
        return self.bench.get(timeout_s)

    def _complete(self, one: ImageSet) -> None:
        self.sets.append(one)
        if len(self.sets) >= self.most:
            self.driver.hold(None)

    def _drop(self) -> None:
        self.dropped += 1

    def play(self, levels: list[int] = LEVELS) -> None:
        self.driver.play("gray", [image(one) for one in levels])

    def finish(self) -> None:
        wait_until(lambda: len(self.sets) >= self.most)


@contextmanager
def played(monkeypatch: pytest.MonkeyPatch, *, most: int = 20, **options: Any) -> Iterator[Played]:
    monkeypatch.setattr(driver_module, "RETRY_S", 0.01)
    made = Played(Bench(**options), most=most)
    yield made
    assert made.driver.close()


@pytest.mark.parametrize("seed", range(8))
def test_each_pair_of_a_set_shows_its_image_whatever_is_lost_or_late(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    latency_ms = 15.0 + 5 * seed
    times = {
        "latency_ms": latency_ms,
        "reported_ms": latency_ms,
        "period_ms": 12.0 + 7 * seed,
        "exposure_ms": 4.0 + seed,
    }
    with played(monkeypatch, lost=0.2, late_ms=25.0, jitter_us=300.0, seed=seed, **times) as made:
        made.play()
        made.finish()
        assert [[level(pair) for pair in one.pairs] for one in made.sets] == [[{one} for one in LEVELS]] * 20
        numbers = [pair.seq for one in made.sets for pair in one.pairs]
        assert numbers == sorted(set(numbers)) and all(one.seq % len(LEVELS) == 0 for one in made.sets)
        assert all(pair.left.trigger == pair.right.trigger for pair in made.seen)
        assert made.dropped == 0 and made.driver.problem == ""


def test_trouble_of_the_projector_drops_the_set_and_the_next_begins_with_the_first_image(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with played(monkeypatch, most=6) as made:
        gets = 0

        def restarted_once() -> None:
            nonlocal gets
            gets += 1
            made.bench.counted["restarts"] += gets == 12

        made.before_get = restarted_once
        made.play()
        made.finish()
        assert made.dropped == 1 and made.driver.problem == ""
        assert [[level(pair) for pair in one.pairs] for one in made.sets] == [[{one} for one in LEVELS]] * 6
        begun = {pair.seq // len(LEVELS) for pair in made.seen}
        assert len(begun) == 7, "the pairs of the dropped set have numbers that no other set has"
        whole = [pair for one in made.sets for pair in one.pairs]
        assert [pair.seq for pair in whole] == sorted({pair.seq for pair in whole})


def test_a_driver_that_fails_for_a_while_is_asked_again_until_there_is_light(monkeypatch: pytest.MonkeyPatch) -> None:
    with played(monkeypatch, most=2) as made:
        show, failures = made.bench.show, 0

        def failing(shown: Any) -> None:
            nonlocal failures
            if failures < 5:
                failures += 1
                raise DriverError("no light")
            show(shown)

        monkeypatch.setattr(made.bench, "show", failing)
        made.play()
        made.finish()
        assert failures == 5 and len(made.sets) == 2 and made.driver.problem == ""


def test_while_it_fails_the_problem_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    with played(monkeypatch) as made:
        made.bench.trouble = "the window is gone"
        made.play()
        wait_until(lambda: "the window is gone" in made.driver.problem)
        made.bench.trouble = ""
        made.finish()
        wait_until(lambda: made.driver.problem == "")


def test_who_holds_it_has_the_projector_alone_and_it_goes_on_with_the_first_image(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with played(monkeypatch, most=10_000) as made:
        made.play()
        wait_until(lambda: len(made.sets) > 3)
        made.driver.hold(20.0)
        shown, sets = made.bench.shown, len(made.sets)
        made.bench.show(image(33))
        assert made.bench.shown == shown + 1 and len(made.sets) == sets
        made.most = sets + 2
        made.play()
        made.finish()
        assert [level(pair) for pair in made.sets[sets].pairs] == [{one} for one in LEVELS]


def test_another_mode_goes_on_with_higher_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    with played(monkeypatch, most=3) as made:
        made.play()
        made.finish()
        made.driver.hold(20.0)
        made.most = 5
        made.play([20, 120])
        made.finish()
        assert [len(one.pairs) for one in made.sets] == [5, 5, 5, 2, 2]
        assert made.sets[3].seq > made.sets[2].pairs[-1].seq and made.sets[3].seq % 2 == 0


def test_a_projector_that_hangs_is_reported_to_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    with played(monkeypatch) as made:
        hanging, over = threading.Event(), threading.Event()

        def hang(_: Any) -> None:
            hanging.set()
            over.wait(30)

        monkeypatch.setattr(made.bench, "show", hang)
        made.play()
        assert hanging.wait(30)
        with pytest.raises(DaemonError, match="does not return"):
            made.driver.hold(0.05)
        over.set()
        made.driver.hold(20.0)
