"""Under every fault the daemon keeps running, reports it, recovers by itself and makes no wrong pair."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from benchmarks.common.box_daemon import Daemon
from drivers.protocols import SIDES, Side
from sim.box.box import Box
from sim.devices.faults import FaultKind
from tests.sim.box.conftest import boxes
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


@pytest.fixture(scope="module")
def measuring() -> Iterator[tuple[Box, Daemon]]:
    """A daemon that measures; every test leaves it running. The cameras' clocks drift apart."""
    with boxes() as make:
        drift = {"left": 100.0, "right": -100.0}
        box = make({"drift_ppm": drift}, scene="plane", layout={"scale": 0.125})
        with Daemon(box) as daemon:
            yield box, daemon


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


def test_a_camera_that_stalls_for_longer_than_a_frame_waits(measuring: tuple[Box, Daemon]) -> None:
    box, daemon = measuring
    before = daemon.step_until_pair()

    def outcomes(side: Side, name: str) -> int:
        return daemon.service.status().cameras[side].fates.get(name, 0)

    late, single = outcomes("left", "late"), outcomes("right", "partner_missing")
    longest_s = daemon.service.config.pairing.max_wait_ms / 1e3
    box.cables["left"].stall(max(2.0, longest_s + 0.5))
    for _ in range(4):
        box.world.step(settle=False)
    box.world.settle()
    wait_until(lambda: outcomes("left", "late") == late + 4, 30, "late frames")
    assert daemon.pair_check.last_pair == before
    assert outcomes("right", "partner_missing") == single + 4
    assert daemon.step_until_pair() == before + 5
    assert daemon.state() == "running" and no_wrong_pair(daemon)


def test_a_camera_is_unplugged_and_plugged_in_again(measuring: tuple[Box, Daemon]) -> None:
    box, daemon = measuring
    for side in SIDES:
        before, losses = daemon.step_until_pair(), daemon.service.status().cameras[side].losses
        box.cables[side].unplug()
        daemon.step_patiently(3)
        wait_until(lambda side=side: f"camera {side} is gone" in daemon.reasons(), 30, "the loss")
        assert daemon.state() == "degraded" and daemon.pair_check.last_pair == before
        box.cables[side].plug()
        daemon.wait_armed()
        assert daemon.step_until_pair() > before
        wait_until(lambda: daemon.state() == "running", 30, "running")
        assert daemon.service.status().cameras[side].losses == losses + 1
    assert no_wrong_pair(daemon)


def test_cameras_whose_clocks_drift_apart(measuring: tuple[Box, Daemon]) -> None:
    box, daemon = measuring
    daemon.step_until_pair()
    pairs, triggers = daemon.pair_check.counts["pairs"], box.world.triggers
    # Uncorrected, the two clocks would part by the whole tolerance of 1 ms within 5 s.
    end, steps = time.monotonic() + 6.5, 0
    while time.monotonic() < end:
        daemon.step_until_pair()
        steps += 1
        time.sleep(0.1)  # the clocks part with the time, not with the number of triggers
    made = daemon.pair_check.counts["pairs"] - pairs
    assert no_wrong_pair(daemon) and made >= steps
    assert made == box.world.triggers - triggers


def test_the_projector_window_and_the_x_server_die_and_come_back(measuring: tuple[Box, Daemon]) -> None:
    box, daemon = measuring
    assert box.server is not None
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
