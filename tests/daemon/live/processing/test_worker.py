"""The worker: which pairs follow the one before, half images under overload, and errors that harm one pair only."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from daemon.common.counters import Counters
from daemon.config.rig_config import Pipeline
from daemon.live.items import CloudItem, Pair
from daemon.live.processing.worker import Worker
from drivers.protocols import Frame, Side
from pipeline.common.errors import PipelineError
from pipeline.reconstruct.cloud import Cloud
from tests.daemon.rigs import SteppedClock
from tools.waiting import wait_until

SIZE = (4, 6)
CLOUD = Cloud(
    np.zeros((*SIZE, 3), np.float32),
    np.zeros(SIZE, np.float32),
    np.zeros(SIZE, np.uint8),
    (np.zeros(SIZE, np.uint8),) * 2,
    np.zeros(SIZE, np.int16),
)


@dataclass
class Stub:
    """Notes how it is called; an image of 1 is rejected; ``gate`` delays it."""

    mode = "single"
    warnings = ()
    calls: list[tuple[int, bool]] = field(default_factory=list)
    colors: int = 0
    gate: threading.Semaphore | None = None

    def warm_up(self, *, strides: tuple[int, ...], use_prior: bool) -> None:
        pass

    def reconstruct(self, left: Any, right: Any, *, stride: int = 1, use_prior: bool = False) -> Cloud:
        if self.gate is not None:
            assert self.gate.acquire(timeout=20)
        self.calls.append((stride, use_prior))
        if (left == right).all() and left[0, 0] == 1:
            raise PipelineError("refused")
        return CLOUD

    def color(self, left: Any) -> Any:
        self.colors += 1
        return np.full((*SIZE, 3), left[0, 0], np.uint8)


class Line:
    """A worker with a stub behind it."""

    def __init__(self, **options: Any) -> None:
        self.clock, self.drops, self.stub = SteppedClock(), Counters(), Stub()
        self.clouds: list[CloudItem] = []
        self.wanted: frozenset[str] = frozenset()
        self.worker = Worker(
            Pipeline(**options), emit=self.clouds.append, drops=self.drops, clock=self.clock,
            wanted=lambda: self.wanted,
        )  # fmt: skip

    def start(self) -> None:
        self.worker.start(lambda: self.stub).result(20)

    def pair(self, seq: int, t_ms: float, value: int = 0) -> None:
        t_ns = round(1e6 * t_ms)

        def frame(side: Side) -> Frame:
            return Frame(side, seq, t_ns, t_ns, "mono8", np.full(SIZE, value, np.uint8))

        before = len(self.stub.calls)
        self.worker.offer(Pair(frame("left"), frame("right")))
        if self.stub.gate is None:
            wait_until(lambda: len(self.stub.calls) > before)

    @property
    def follows(self) -> list[bool]:
        return [use_prior for _, use_prior in self.stub.calls]


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    made.start()
    yield made
    assert made.worker.stop(20)


def test_only_the_first_pair_and_those_after_a_gap_use_no_prior(line: Line) -> None:
    for seq, t_ms in ((7, 0), (8, 33), (9, 66), (40, 1089), (41, 1122), (43, 1188)):
        line.pair(seq, t_ms)
    assert line.follows == [False, True, True, False, True, True]


def test_other_settings_and_a_refused_pair_reset_the_prior(line: Line) -> None:
    line.pair(0, 0)
    line.pair(1, 33)
    line.worker.replace(lambda: line.stub, 20)
    line.pair(2, 66)
    line.pair(3, 99, value=1)
    line.pair(4, 132)
    line.pair(5, 165)
    assert line.follows == [False, True, False, True, False, True]
    assert line.drops.snapshot() == {"pairs_refused_by_pipeline": 1}


def test_without_the_temporal_prior_every_pair_stands_alone() -> None:
    line = Line(temporal_prior=False)
    line.start()
    for seq in range(3):
        line.pair(seq, 33 * seq)
    assert line.follows == [False] * 3
    assert line.worker.stop(20)


@pytest.mark.parametrize(("overload", "stride"), [("half", 2), ("skip", 1)])
def test_dropped_pairs_bring_half_images_where_that_is_wanted(overload: str, stride: int) -> None:
    line = Line(overload=overload)
    line.stub.gate = threading.Semaphore(0)
    line.start()
    for seq in range(6):
        line.clock.now_ns += 33_000_000
        line.pair(seq, 33 * seq)
        if seq == 0:
            wait_until(lambda: len(line.worker._queue) == 0)
        if seq == 3:  # two were dropped; the next one is taken
            line.stub.gate.release()
            wait_until(lambda: len(line.worker._queue) == 0)
    line.pair(6, 33 * 6)
    for _ in range(2):
        line.stub.gate.release()
    wait_until(lambda: len(line.stub.calls) == 3)
    assert line.drops["pairs_pipeline_busy"] == 4
    assert [call[0] for call in line.stub.calls] == [1, 1, stride] and line.worker.stride == stride
    assert line.worker.stop(20)
    assert [cloud.stride for cloud in line.clouds] == [1, 1, stride]


def test_pairs_that_come_before_the_kernels_are_ready_are_counted_and_stopping_waits_for_no_compiler() -> None:
    line, ready = Line(), threading.Event()

    def make() -> Stub:
        assert ready.wait(20)
        return line.stub

    done = line.worker.start(make)
    line.worker.offer(Pair(*(Frame(s, 0, 0, 0, "mono8", np.zeros(SIZE, np.uint8)) for s in ("left", "right"))))
    assert line.drops.snapshot() == {"pairs_not_ready": 1}
    assert line.worker.stop(20)
    ready.set()
    done.result(20)


def test_what_goes_wrong_while_it_is_made_is_handed_on() -> None:
    def make() -> Stub:
        raise PipelineError("no such pattern")

    with pytest.raises(PipelineError, match="no such pattern"):
        Line().worker.start(make).result(20)


def test_color_and_normals_are_computed_only_for_clouds_that_need_them(line: Line) -> None:
    line.pair(0, 0, value=3)
    line.wanted = frozenset(("rgb",))
    line.pair(1, 33, value=4)
    line.wanted = frozenset(("normals", "rgb"))
    line.pair(2, 66, value=5)
    line.wanted = frozenset()
    line.pair(3, 99, value=6)
    wait_until(lambda: len(line.clouds) == 4)
    found = [item.cloud for item in line.clouds]
    assert [None if cloud.rgb is None else int(cloud.rgb[0, 0, 0]) for cloud in found] == [None, 4, 5, None]
    assert [cloud.normals is not None for cloud in found] == [False, False, True, False]
    assert line.stub.colors == 2 and found[0] is found[3] is CLOUD


def test_a_pair_of_another_mode_is_not_measured_and_counted(line: Line) -> None:
    line.stub.mode = "gray"
    line.stub.gate = threading.Semaphore(0)
    line.pair(0, 0)
    wait_until(lambda: line.worker.finished == 1)
    assert not line.stub.calls and not line.clouds
    assert line.drops.snapshot() == {"pairs_of_another_mode": 1} and line.worker.dropped == 1


def test_a_pair_that_waits_when_the_worker_stops_is_counted() -> None:
    line = Line()
    line.stub.gate = threading.Semaphore(0)
    line.start()
    line.pair(0, 0)
    wait_until(lambda: line.worker.waiting == 0)
    line.pair(1, 33)
    assert not line.worker.stop(0)  # the first one is being measured
    line.stub.gate.release()
    assert line.worker.stop(20)
    assert len(line.clouds) == 1 and line.drops.snapshot() == {"pairs_stopped": 1}
