"""Each fault has its effect, on its side, at its trigger; the ledger accounts for every frame."""

from __future__ import annotations

import contextlib
from collections import Counter

import numpy as np
import pytest

from drivers.errors import DeviceLost
from drivers.protocols import SIDES, TRIGGER_MODULUS
from sim.devices.clock import SteppedClock
from sim.devices.faults import RANDOM_KINDS, Fault, FaultKind, FaultPlan
from sim.devices.projector import SimProjector
from sim.devices.trigger_world import SimWorld


class Numbered:
    """Images that encode their trigger and side."""

    def pair(self, index):
        out = []
        for side in (0, 1):
            image = np.full((2, 3, 3), (index % 256, index // 256 % 256, side), np.uint8)
            image.setflags(write=False)
            out.append(image)
        return tuple(out)


def world_with(plan, **options):
    options = {"clock": SteppedClock(), "keep_entries": True, "queue_frames": 64} | options
    return SimWorld(Numbered(), SimProjector(np.zeros((4, 5, 3), np.uint8)), (3, 2), "rgb8", plan=plan, **options)


def started(plan, **options):
    world = world_with(plan, **options)
    for camera in world.cameras.values():
        camera.open()
        camera.start()
    return world


def read_all(camera):
    frames = []
    while (frame := camera.read(0.0)) is not None:
        frames.append(frame)
    return frames


def index_in(frame):
    """The trigger at which an image was really exposed."""
    return int(frame.image[0, 0, 0]) + 256 * int(frame.image[0, 0, 1])


def numbers_after(plan, steps=6, **options):
    world = started(plan, **options)
    for _ in range(steps):
        world.step()
    return {side: [frame.trigger for frame in read_all(world.cameras[side])] for side in SIDES}


def test_without_faults_every_trigger_gives_a_pair():
    numbers = numbers_after(FaultPlan.none())
    assert numbers == {"left": [0, 1, 2, 3, 4, 5], "right": [0, 1, 2, 3, 4, 5]}


def test_a_lost_frame_is_missing_on_its_side_only():
    numbers = numbers_after(FaultPlan.script([Fault(FaultKind.LOST, 2, "left")]))
    assert numbers == {"left": [0, 1, 3, 4, 5], "right": [0, 1, 2, 3, 4, 5]}


def test_a_late_frame_arrives_behind_newer_ones_with_its_own_time():
    world = started(FaultPlan.script([Fault(FaultKind.LATE, 1, "right", 2)]))
    clock = world._clock
    for _ in range(5):
        world.step()
        clock.advance(1_000_000)
    left, right = (read_all(world.cameras[side]) for side in SIDES)
    assert [f.trigger for f in right] == [0, 2, 3, 1, 4]
    late = right[3]
    assert index_in(late) == 1
    assert abs(late.t_exposure_ns - left[1].t_exposure_ns) < 2_000
    assert late.t_host_ns - left[1].t_host_ns == 2_000_000


def test_late_frames_still_on_their_way_are_pending_until_flushed():
    world = started(FaultPlan.script([Fault(FaultKind.LATE, 0, "left", 5)]))
    world.step()
    assert (world.pending, read_all(world.cameras["left"])) == (1, [])
    world.flush()
    assert (world.pending, len(read_all(world.cameras["left"]))) == (0, 1)


def test_a_duplicate_arrives_twice():
    numbers = numbers_after(FaultPlan.script([Fault(FaultKind.DUPLICATE, 3, "left")]))
    assert numbers["left"] == [0, 1, 2, 3, 3, 4, 5]


def test_an_extra_first_frame_comes_before_the_first_trigger():
    world = started(FaultPlan.script([Fault(FaultKind.EXTRA_FIRST, 0, "right")]), first_number=0)
    world.step()
    right = read_all(world.cameras["right"])
    assert [f.trigger for f in right] == [TRIGGER_MODULUS - 1, 0]
    assert right[1].t_exposure_ns - right[0].t_exposure_ns > 50_000_000
    assert len(read_all(world.cameras["left"])) == 1


def test_a_wrong_number_keeps_its_image_and_its_time():
    world = started(FaultPlan.script([Fault(FaultKind.WRONG_NUMBER, 2, "left", 1)]))
    for _ in range(4):
        world.step()
        world._clock.advance(1_000_000)
    left, right = (read_all(world.cameras[side]) for side in SIDES)
    assert [f.trigger for f in left] == [0, 1, 3, 3]
    assert index_in(left[2]) == 2
    assert abs(left[2].t_exposure_ns - right[2].t_exposure_ns) < 2_000


def test_a_blackout_takes_both_sides_for_its_length():
    numbers = numbers_after(FaultPlan.script([Fault(FaultKind.BLACKOUT, 1, None, 3)]))
    assert numbers == {"left": [0, 4, 5], "right": [0, 4, 5]}


def test_a_camera_is_gone_and_comes_back():
    world = started(FaultPlan.script([Fault(FaultKind.GONE, 1, "left", 3)]))
    camera = world.cameras["left"]
    world.step()
    world.step()
    with pytest.raises(DeviceLost, match=r"left.*unplugged"):
        camera.read(0.0)
    with pytest.raises(DeviceLost, match=r"left.*unplugged"):
        camera.open()
    for _ in range(3):
        world.step()
    camera.open()
    camera.start()
    world.step()
    assert [f.trigger for f in read_all(camera)] == [5]
    assert len(read_all(world.cameras["right"])) == 6
    assert camera.health().counters["lost_device"] == 1
    assert Counter(e.outcome for e in world.ledger.entries if e.side == "left") == {
        "sent": 2,
        "dropped": 1,
        "gone": 3,
        "not_listening": 1,
    }


def test_trigger_numbers_wrap_at_32_bits():
    numbers = numbers_after(FaultPlan.none(), first_number=TRIGGER_MODULUS - 2, steps=4)
    assert numbers["left"] == [TRIGGER_MODULUS - 2, TRIGGER_MODULUS - 1, 0, 1]


def test_exposures_of_a_pair_agree_to_microseconds():
    world = started(FaultPlan.none())
    for _ in range(50):
        world.step()
        world._clock.advance(33_000_000)
    left, right = (read_all(world.cameras[side]) for side in SIDES)
    apart = [abs(a.t_exposure_ns - b.t_exposure_ns) for a, b in zip(left, right, strict=True)]
    assert 0 < max(apart) < 5_000
    assert all(f.t_host_ns - f.t_exposure_ns >= 7_990_000 for f in left)


def test_a_plan_is_a_function_of_its_seed():
    a, b, c = (FaultPlan.random(seed, 0.05) for seed in (1, 1, 2))
    kinds = [[plan.of(i, side).kind for i in range(2000) for side in SIDES] for plan in (a, b, c)]
    assert kinds[0] == kinds[1]
    assert kinds[0] != kinds[2]


def test_drawn_faults_come_at_their_rates():
    plan = FaultPlan.random(4, 0.0, lost=0.03, late=0.02, duplicate=0.01)
    for side in SIDES:
        counts = Counter(plan.of(i, side).kind for i in range(20_000))
        assert counts[FaultKind.LOST] / 20_000 == pytest.approx(0.03, rel=0.15)
        assert counts[FaultKind.LATE] / 20_000 == pytest.approx(0.02, rel=0.15)
        assert counts[FaultKind.DUPLICATE] / 20_000 == pytest.approx(0.01, rel=0.2)
        assert counts[FaultKind.GONE] == 0


def test_the_sides_fail_independently():
    plan = FaultPlan.random(4, 0.0, lost=0.1)
    both = [all(plan.of(i, side).kind is FaultKind.LOST for side in SIDES) for i in range(20_000)]
    assert np.mean(both) == pytest.approx(0.01, rel=0.3)


def test_every_frame_of_a_long_bad_run_is_accounted_for():
    steps = 3000
    world = started(FaultPlan.random(11, 0.02, extra_first="left"))
    got, away = {side: [] for side in SIDES}, set()
    for _ in range(steps):
        world.step()
        world._clock.advance(33_000_000)
        for side, camera in world.cameras.items():
            with contextlib.suppress(DeviceLost):
                if camera.state == "closed" and side in away:
                    camera.open()
                    camera.start()
                    away.remove(side)
            try:
                got[side] += [] if side in away else read_all(camera)
            except DeviceLost:
                away.add(side)
    world.flush()
    counts = world.ledger.counts
    for side in SIDES:
        got[side] += read_all(world.cameras[side])
        assert len(got[side]) == counts[side, "sent"] - counts[side, "dropped"] - counts[side, "overflow"]
        came = counts[side, "sent"] + counts[side, "not_listening"]
        missing = sum(counts[side, kind] for kind in (FaultKind.LOST, FaultKind.BLACKOUT, FaultKind.GONE))
        extra = counts[side, FaultKind.DUPLICATE] + counts[side, FaultKind.EXTRA_FIRST]
        assert came == steps - missing + extra
        for kind in RANDOM_KINDS:
            assert counts[side, kind] > 0, kind
        wrong = {e.index for e in world.ledger.of("wrong_number") if e.side == side}
        for frame in got[side]:
            if index_in(frame) not in wrong and frame.trigger != TRIGGER_MODULUS - 1:
                assert frame.trigger == index_in(frame)


def test_impossible_plans_are_refused():
    with pytest.raises(ValueError, match=r"faults\.lost is 1\.5.*from 0 to 1"):
        FaultPlan.random(0, lost=1.5)
    with pytest.raises(ValueError, match="length 0"):
        Fault(FaultKind.LATE, 3, "left", 0)
    with pytest.raises(ValueError, match="extra_first cannot be drawn"):
        FaultPlan(rates={FaultKind.EXTRA_FIRST: 0.1})
