"""The world shows what the projector shows, gives both cameras one edge, and keeps a true ledger of it."""

from __future__ import annotations

import itertools
import threading
import time

import numpy as np
import pytest

from drivers.protocols import SIDES
from sim.box.exposure_ledger import Ledger, Trigger, digest
from sim.box.output_grabber import DisplayLost
from sim.box.world import NotSettled, World
from sim.devices.faults import Fault, FaultKind, FaultPlan

SIZE = 16, 8


class FakeScreen:
    def __init__(self) -> None:
        self.image = np.full((SIZE[1], SIZE[0], 3), 7, np.uint8)
        self.lost = False

    def grab(self):
        if self.lost:
            raise DisplayLost("display :7: the X server is gone")
        return self.image


class FakeStage:
    """Counts are the image's mean and the instant; the noise is the seed."""

    def __init__(self) -> None:
        self.lit = 0

    def counts(self, image, instant=0):
        self.lit += 1
        one = np.full((2, 2), image.mean() + 100 * instant, np.float32)
        return one, one + 1

    def images(self, counts, seed):
        return tuple((1000 * seed + part).astype(np.uint16) for part in counts)


class FakeCable:
    def __init__(self) -> None:
        self.light = None
        self.frames, self.calls = [], []
        self.busy_s = 0.0

    def show(self, image):
        self.light = image.copy()

    def pulse(self, t_ns):
        self.frames.append((t_ns, self.light))

    def wait_idle(self, timeout_s):
        time.sleep(min(timeout_s, self.busy_s))
        return self.busy_s <= timeout_s

    def __getattr__(self, name):
        return lambda *values: self.calls.append((name, *values))


class Bench:
    def __init__(self, plan=None, **options) -> None:
        self.screen, self.stage = FakeScreen(), FakeStage()
        self.cables = {side: FakeCable() for side in SIDES}
        options = {"period_s": 0.0} | options
        self.world = World(self.screen, self.stage, self.cables, size=SIZE, plan=plan, **options)

    def frames(self, side):
        return self.cables[side].frames


def test_both_cameras_get_one_edge_of_the_same_time_under_the_image_shown() -> None:
    bench = Bench(instants=3)
    for value in (7, 7, 200, 7):
        bench.screen.image = np.full_like(bench.screen.image, value)
        shown = bench.world.step()
        assert {bench.frames(side)[-1][0] for side in SIDES} == {shown.t_ns}
        assert shown.image == digest(bench.screen.image)
        for offset, side in enumerate(SIDES):
            light = bench.frames(side)[-1][1]
            assert (light == 1000 * shown.index + value + 100 * shown.instant + offset).all()
            assert bench.world.ledger.exposure_of(side, light) is shown
    assert (bench.world.triggers, bench.world.ledger.last.instant) == (4, 0)


def test_edges_keep_their_distance() -> None:
    bench = Bench(period_s=0.003)
    times = [bench.world.step().t_ns for _ in range(10)]
    assert min(b - a for a, b in itertools.pairwise(times)) >= 3_000_000


def test_an_image_shown_before_is_not_lit_again() -> None:
    bench = Bench(lit_images=2)
    for value in (1, 2, 1, 2, 2, 1):
        bench.screen.image = np.full_like(bench.screen.image, value)
        bench.world.step()
    assert bench.stage.lit == 2
    for value in (3, 1, 2):
        bench.screen.image = np.full_like(bench.screen.image, value)
        bench.world.step()
    assert bench.stage.lit == 4


def test_without_a_display_the_scene_is_dark_until_it_is_back() -> None:
    bench = Bench()
    assert not bench.world.step().dark
    bench.screen.lost = True
    shown = bench.world.step()
    assert shown.dark and bench.world.display_problem.endswith("the X server is gone")
    assert (bench.frames("left")[-1][1] == 1000).all()
    bench.screen.lost = False
    assert not bench.world.step().dark and bench.world.display_problem == ""
    bench.screen.image = np.full((4, 4, 3), 9, np.uint8)
    assert bench.world.step().dark and "shows 4 x 4" in bench.world.display_problem
    assert bench.world.ledger.dark == 2


FAULTS = {
    "lost at even triggers": (Fault(FaultKind.LOST, 2, "left"), [("drop", 1)], 6, 6),
    "lost at odd triggers": (Fault(FaultKind.LOST, 3, "left"), [("truncate", 1)], 6, 6),
    "late": (Fault(FaultKind.LATE, 1, "left", 2), [("stall", 0.0)], 6, 6),
    "duplicate": (Fault(FaultKind.DUPLICATE, 1, "left"), [], 7, 6),
    "wrong number": (Fault(FaultKind.WRONG_NUMBER, 1, "left"), [], 5, 6),
    "blackout": (Fault(FaultKind.BLACKOUT, 1, None, 2), [], 4, 4),
    "gone": (Fault(FaultKind.GONE, 1, "left", 3), [("unplug",), ("plug",)], 3, 6),
    "extra first": (Fault(FaultKind.EXTRA_FIRST, 0, "left"), [], 7, 6),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_affects_its_camera_and_is_recorded(name: str) -> None:
    fault, calls, left, right = FAULTS[name]
    bench = Bench(FaultPlan.script([fault]))
    shown = [bench.world.step() for _ in range(6)]
    assert bench.cables["left"].calls == calls and bench.cables["right"].calls == []
    assert (len(bench.frames("left")), len(bench.frames("right"))) == (left, right)
    if fault.kind is not FaultKind.EXTRA_FIRST:
        assert [s.index for s in shown if s.faults["left"] is fault.kind] == [
            i for i in range(6) if fault.affects(i, "left")
        ]
        assert bench.world.ledger.counts["left", fault.kind] > 0


def test_lock_step_waits_for_the_frames_and_names_the_camera_that_kept_them() -> None:
    bench = Bench(settle_s=0.2)
    bench.cables["right"].busy_s = 0.01
    bench.world.step()
    bench.cables["right"].busy_s = 1e9
    with pytest.raises(NotSettled, match="camera right"):
        bench.world.step()
    bench.world.step(settle=False)


def test_a_camera_that_is_gone_is_not_waited_for() -> None:
    bench = Bench(FaultPlan.script([Fault(FaultKind.GONE, 0, "right", 2)]), settle_s=0.05)
    bench.cables["right"].busy_s = 1e9
    bench.world.step()


def test_running_ends_on_request_and_skips_late_triggers() -> None:
    bench, stop = Bench(), threading.Event()
    bench.screen.grab = lambda: (time.sleep(0.005), bench.screen.image)[1]
    thread = threading.Thread(target=bench.world.run, args=(1000, stop))
    thread.start()
    deadline = time.monotonic() + 30
    while bench.world.late == 0 or bench.world.triggers < 5:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    stop.set()
    thread.join(10)
    assert not thread.is_alive()
    with pytest.raises(ValueError, match="rate_hz is 0"):
        bench.world.run(0, stop)


def test_the_ledger_keeps_the_last_triggers_and_counts_all() -> None:
    ledger = Ledger(keep=3)
    images = [np.full((2, 2), k, np.uint8) for k in range(5)]
    none = dict.fromkeys(SIDES, FaultKind.NONE)
    for k, image in enumerate(images):
        ledger.note(Trigger(k, 0, b"", False, 0, none, dict.fromkeys(SIDES, digest(image))))
    found = [ledger.exposure_of("left", image) for image in images]
    assert [shown and shown.index for shown in found] == [None, None, 2, 3, 4]
    assert ledger.counts == {("left", FaultKind.NONE): 5, ("right", FaultKind.NONE): 5}
