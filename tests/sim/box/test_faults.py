"""Under every fault the daemon keeps running, reports it, recovers by itself and makes no wrong pair."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import pytest

from benchmarks.common.box_daemon import Daemon
from drivers.protocols import SIDES
from sim.box.box import Box
from sim.devices.faults import FaultKind
from tools.waiting import wait_until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]

# Faults of frames, far enough apart to recover in between: kind, trigger, side, length.
SCRIPT = [
    ("lost", 20, "left", 1),
    ("lost", 31, "right", 1),
    ("late", 40, "left", 3),
    ("duplicate", 50, "right", 1),
    ("wrong_number", 60, "left", 1),
    ("blackout", 90, None, 3),
    ("lost", 100, None, 1),
    ("wrong_number", 110, "right", 1),
]


def no_wrong_pair(daemon: Daemon) -> bool:
    counts = daemon.pair_check.counts
    summary = f"{counts['pairs']} pairs ({counts['dark']} dark), {counts['wrong']} wrong, {counts['unknown']} unknown"
    print(f"\n{summary}")  # noqa: T201 - the count is the result
    return counts["wrong"] == counts["unknown"] == 0


def test_lost_broken_late_and_superfluous_frames(make_box: Callable[..., Box]) -> None:
    script = [dict(zip(("kind", "at", "side", "length"), fault, strict=True)) for fault in SCRIPT]
    box = make_box(scene="plane", layout={"scale": 0.125}, faults={"script": script})
    with Daemon(box) as daemon:
        daemon.step_patiently(160)
        daemon.step_until_pair()
        status = daemon.service.status()
    counts = box.world.ledger.counts
    assert all(counts[side, FaultKind.NONE] for side in SIDES)
    harmless = {FaultKind.NONE, FaultKind.LATE, FaultKind.DUPLICATE}
    whole = sum(all(shown.faults[side] in harmless for side in SIDES) for shown in box.world.ledger.triggers)
    assert no_wrong_pair(daemon)
    assert daemon.pair_check.counts["pairs"] == whole
    drivers = {side: status.cameras[side].driver for side in SIDES}
    assert status.state == "running" and drivers["right"]["incomplete"] == 1
    states = {side: box.cables[side].state() for side in SIDES}
    assert [states[side].dropped for side in SIDES] == [2, 1]
    assert states["right"].truncated == 1 and states["right"].missed == 1


def test_a_camera_that_stalls_for_longer_than_a_frame_waits(make_box: Callable[..., Box]) -> None:
    box = make_box(scene="plane", layout={"scale": 0.125})
    with Daemon(box) as daemon:
        before = daemon.step_until_pair()
        longest_s = daemon.service.config.pairing.max_wait_ms / 1e3
        box.cables["left"].stall(max(2.0, longest_s + 0.5))
        for _ in range(4):
            box.world.step(settle=False)
        box.world.settle()
        wait_until(lambda: daemon.service.status().cameras["left"].fates.get("late", 0) == 4, 30, "late frames")
        assert daemon.pair_check.last_pair == before
        fates = {side: daemon.service.status().cameras[side].fates for side in SIDES}
        assert fates["right"]["partner_missing"] == 4
        assert daemon.step_until_pair() == before + 5
        assert daemon.state() == "running" and no_wrong_pair(daemon)


def test_a_camera_is_unplugged_and_plugged_in_again(make_box: Callable[..., Box]) -> None:
    box = make_box(scene="plane", layout={"scale": 0.125})
    with Daemon(box) as daemon:
        for side in SIDES:
            before = daemon.step_until_pair()
            box.cables[side].unplug()
            daemon.step_patiently(3)
            wait_until(lambda side=side: f"camera {side} is gone" in daemon.reasons(), 30, "the loss")
            assert daemon.state() == "degraded" and daemon.pair_check.last_pair == before
            box.cables[side].plug()
            daemon.wait_armed()
            assert daemon.step_until_pair() > before
            wait_until(lambda: daemon.state() == "running", 30, "running")
            assert daemon.service.status().cameras[side].losses == 1
        assert no_wrong_pair(daemon)


def test_cameras_whose_clocks_drift_apart(make_box: Callable[..., Box]) -> None:
    box = make_box({"drift_ppm": {"left": 100.0, "right": -100.0}}, scene="plane", layout={"scale": 0.125})
    with Daemon(box) as daemon:
        # Uncorrected, the two clocks would part by the whole tolerance of 1 ms within 5 s.
        end, steps = time.monotonic() + 8, 0
        while time.monotonic() < end:
            daemon.step_until_pair()
            steps += 1
            time.sleep(0.1)  # the clocks part with the time, not with the number of triggers
        counts = daemon.pair_check.counts
        assert no_wrong_pair(daemon) and counts["pairs"] >= steps
        assert counts["pairs"] == box.world.triggers


def test_the_projector_window_and_the_x_server_die_and_come_back(make_box: Callable[..., Box]) -> None:
    box = make_box(scene="plane", layout={"scale": 0.125})
    with Daemon(box) as daemon:
        daemon.step_until_pair()
        pattern = box.world.ledger.last.image
        projector = daemon.rig.projector
        os.kill(projector.window_pid, signal.SIGKILL)
        wait_until(lambda: "projector" in daemon.reasons(), 30, "the loss of the window")
        daemon.step_patiently(3)
        wait_until(lambda: daemon.state() == "running", 30, "the window's return")
        daemon.step_until_pair()
        assert box.world.ledger.last.image == pattern
        box.server.kill()
        wait_until(lambda: "projector" in daemon.reasons(), 30, "the loss of the X server")
        dark = daemon.step_until_pair()
        assert box.world.ledger.last.dark and box.world.ledger.last.index == dark
        box.server.restart()
        wait_until(lambda: daemon.state() == "running", 60, "the projector's return")
        wait_until(lambda: box.world.step().image == pattern, 30, "the pattern")
        daemon.step_until_pair()
        assert not box.world.ledger.last.dark
        assert no_wrong_pair(daemon)
