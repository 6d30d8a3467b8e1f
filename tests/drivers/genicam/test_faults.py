"""What goes wrong between a camera and its driver: nothing is invented, everything lost is counted, all recovers."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.live.acquisition.pairer import Pairer
from daemon.live.acquisition.pairing_events import PairingSettings
from daemon.live.items import Pair
from drivers.errors import DeviceLost
from drivers.protocols import Camera, Frame
from sim.gentl.cable import Cable
from tools.waiting import wait_until

Make = Callable[..., Camera]
Rig = tuple[Cable, Cable]


@pytest.fixture
def make(ours: Path, opened: Make, rig: Rig) -> Make:  # noqa: ARG001 - the cameras must be there
    def camera(serial: str = "A1", **options: Any) -> Camera:
        side = "left" if serial == "A1" else "right"
        named = {"producer": str(ours), "serial": serial, "exposure_us": 1000.0, "pixel_format": "BayerRG8"}
        return opened({**named, **options}, side=side)

    return camera


@pytest.fixture
def running(make: Make, rig: Rig) -> tuple[Cable, Camera]:
    """A camera that measures, and its cable."""
    camera = make()
    start(camera, rig[0])
    return rig[0], camera


def start(camera: Camera, cable: Cable) -> None:
    camera.open()
    camera.start()
    assert cable.wait_armed(5)


def pulses(cable: Cable, count: int) -> list[int]:
    """Pulses that the camera takes, each with its own grey image; their times."""
    times = []
    for _ in range(count):
        number = cable.state().image
        width, height = cable.size
        cable.show(np.full((height, width), (number * 7 + 1) % 256, np.uint8))
        times.append(time.monotonic_ns())
        assert cable.pulse(times[-1])
        assert cable.wait_idle(5)
    return times


def pending(camera: Camera, quiet_s: float = 0.3) -> list[Frame]:
    """All frames that come."""
    found = []
    while (frame := camera.read(quiet_s)) is not None:
        found.append(frame)
    return found


def counter(camera: Camera, name: str) -> int:
    return camera.health().counters.get(name, 0)


def lose(camera: Camera) -> str:
    """Read until the camera is lost; return the message."""
    with pytest.raises(DeviceLost) as caught:
        for _ in range(100):
            camera.read(0.1)
    return str(caught.value)


def test_frames_lost_on_the_cable_leave_a_gap(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    pulses(cable, 3)
    cable.drop(2)
    pulses(cable, 5)
    assert [frame.trigger for frame in pending(camera)] == [0, 1, 2, 5, 6, 7]
    wait_until(lambda: counter(camera, "lost") == 2)
    assert counter(camera, "incomplete") == 0


def test_a_lost_first_frame_leaves_a_gap_too(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    cable.drop(1)
    pulses(cable, 3)
    assert [frame.trigger for frame in pending(camera)] == [1, 2]


def test_incomplete_frames_are_dropped_and_counted_once(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    pulses(cable, 2)
    cable.truncate(3)
    pulses(cable, 5)
    found = pending(camera)
    assert [frame.trigger for frame in found] == [0, 1, 5, 6]
    for frame in found:
        assert len(np.unique(frame.image)) == 1, "half an image was delivered"
    wait_until(lambda: counter(camera, "incomplete") == 3)
    pulses(cable, 1)
    assert pending(camera)[0].trigger == 7
    wait_until(lambda: counter(camera, "incomplete") == 3)
    assert counter(camera, "lost") == 0, "counted twice"


def test_a_stall_of_two_seconds_changes_no_time_and_loses_nothing(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    pulses(cable, 5)
    assert len(pending(camera)) == 5
    shift = time.time_ns() - time.monotonic_ns()
    cable.stall(2.0)
    at = time.monotonic_ns()
    times = [at + k * 50_000_000 for k in range(5)]
    for t_ns in times:
        assert cable.pulse(t_ns)
    found = [frame for _ in times if (frame := camera.read(5.0)) is not None]
    assert [frame.trigger for frame in found] == [5, 6, 7, 8, 9]
    for frame, t_ns in zip(found, times, strict=True):
        assert frame.t_host_ns - frame.t_exposure_ns > 1_500_000_000
        assert abs(frame.t_exposure_ns - shift - t_ns) < 1_000_000
    after = pulses(cable, 3)
    for frame, t_ns in zip(pending(camera), after, strict=True):
        assert abs(frame.t_exposure_ns - shift - t_ns) < 1_000_000
    assert counter(camera, "clock_resets") == counter(camera, "lost") == 0


def test_pulses_that_come_too_soon_are_counted_and_move_no_number(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    at = time.monotonic_ns()
    for k in range(30):  # every third one comes when the camera is ready
        assert cable.pulse(at + k * 900_000)
    assert cable.wait_idle(5)
    found = pending(camera)
    assert cable.state().missed > 5
    assert [frame.trigger for frame in found] == list(range(30 - cable.state().missed))
    wait_until(lambda: counter(camera, "missed_trigger") == cable.state().missed)
    assert counter(camera, "lost") == 0


@pytest.mark.parametrize("drift_ppm", [pytest.param(-100.0, marks=pytest.mark.long), 100.0])
def test_exposure_times_follow_a_clock_that_drifts(running: tuple[Cable, Camera], drift_ppm: float) -> None:
    cable, camera = running
    cable.set_clock(5 * 10**15, drift_ppm)
    pulses(cable, 1)
    pending(camera)
    shift = time.time_ns() - time.monotonic_ns()
    end = time.monotonic() + 3.5
    while time.monotonic() < end:
        (t_ns,) = pulses(cable, 1)
        frame = camera.read(5.0)
        assert frame is not None
        assert abs(frame.t_exposure_ns - shift - t_ns) < 1_000_000
        time.sleep(0.02)  # the clock drifts with the time, not with the number of triggers


def test_a_camera_clock_that_was_reset_is_determined_again(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    pulses(cable, 3)
    assert len(pending(camera)) == 3
    cable.set_clock(17)
    wait_until(lambda: counter(camera, "clock_resets") >= 1 or camera.read(0.05) is not None)
    shift = time.time_ns() - time.monotonic_ns()
    for t_ns in pulses(cable, 3):
        frame = camera.read(5.0)
        assert frame is not None
        assert abs(frame.t_exposure_ns - shift - t_ns) < 1_000_000


def test_a_pulled_plug_is_distinguished_from_a_missing_trigger(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    pulses(cable, 2)
    assert len(pending(camera)) == 2
    assert pending(camera, 1.5) == [], "no trigger, yet no loss"
    cable.unplug()
    assert "is gone" in lose(camera)
    with pytest.raises(DeviceLost, match=r"no camera with serial 'A1'.* there are: FringedCam serial 'A2'"):
        camera.open()
    cable.plug()
    start(camera, cable)
    pulses(cable, 3)
    assert [frame.trigger for frame in pending(camera)] == [0, 1, 2]


def test_one_pulled_plug_leaves_the_other_camera_alone(make: Make, rig: Rig) -> None:
    left, right = make("A1"), make("A2")
    for camera, cable in zip((left, right), rig, strict=True):
        start(camera, cable)
    rig[0].unplug()
    pulses(rig[1], 5)
    assert [frame.trigger for frame in pending(right)] == list(range(5))
    lose(left)
    rig[0].plug()
    start(left, rig[0])
    pulses(rig[1], 3)
    assert [frame.trigger for frame in pending(right)] == [5, 6, 7]
    pulses(rig[0], 1)
    assert [frame.trigger for frame in pending(left)] == [0]


def test_a_plug_that_is_pulled_while_opening_or_stopped_is_a_lost_device(make: Make, rig: Rig) -> None:
    camera = make()
    camera.open()
    rig[0].unplug()
    with pytest.raises(DeviceLost):
        camera.start()
        lose(camera)
        raise DeviceLost("lost while reading")
    camera.close()
    rig[0].plug()
    start(camera, rig[0])
    rig[0].unplug()
    with pytest.raises(DeviceLost):
        camera.stop()
        raise DeviceLost("stopping a camera that is gone may succeed")


def test_a_killed_process_frees_the_camera(running: tuple[Cable, Camera]) -> None:
    cable, camera = running
    os.kill(cable.state().open_by, signal.SIGKILL)
    assert "it ended" in lose(camera)
    start(camera, cable)
    pulses(cable, 2)
    assert [frame.trigger for frame in pending(camera)] == [0, 1]


def test_a_stopped_process_is_given_up(ours: Path, rig: Rig) -> None:
    from drivers.remote import RemoteCamera
    from drivers.remote.camera import Limits

    options = {"producer": str(ours), "serial": "A1"}
    camera = RemoteCamera("left", "drivers.genicam.camera:open_alone", options, Path("/"), limits=Limits(silence_s=0.5))
    start(camera, rig[0])
    assert camera.pid is not None
    os.kill(camera.pid, signal.SIGSTOP)
    assert "has sent no heartbeat" in lose(camera)
    start(camera, rig[0])
    camera.close()


def test_what_nobody_reads_is_dropped_and_counted(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make(buffers=64)  # more than there are images: a loaded machine loses none before the ring
    start(camera, cable)
    pulses(cable, 60)
    wait_until(lambda: counter(camera, "ring_full") >= 60 - 16)
    found = pending(camera)
    assert found[-1].trigger == 59
    assert len(found) + counter(camera, "ring_full") == 60
    for frame in found:
        assert (frame.image == (frame.trigger * 7 + 1) % 256).all()


def test_pairs_survive_everything_that_happens_to_single_frames(make: Make, rig: Rig) -> None:
    """Drops, half images and an unplugged camera: every pair is of one exposure, and pairs come back."""
    rng = np.random.default_rng(11)
    cameras = {"left": make("A1"), "right": make("A2")}
    for camera, cable in zip(cameras.values(), rig, strict=True):
        start(camera, cable)
    pairer = Pairer(PairingSettings(tolerance_ns=2_000_000))
    pairs: list[Pair] = []
    shown = 0

    def exposure(*read: str) -> None:
        nonlocal shown
        shown += 1
        at = time.monotonic_ns()
        for cable in rig:
            width, height = cable.size
            cable.show(np.full((height, width), shown % 256, np.uint8))
            cable.pulse(at)
        for cable in rig:
            assert cable.wait_idle(5)
        for side in read or cameras:
            for frame in pending(cameras[side], 0.02):
                pairs.extend(event for event in pairer.feed(frame) if isinstance(event, Pair))

    for k in range(60):
        if k % 10 == 5:
            rig[rng.integers(2)].drop(1)
        if k % 10 == 8:
            rig[rng.integers(2)].truncate(1)
        exposure()
    assert len(pairs) >= 40
    rig[0].unplug()
    exposure("right")  # the left one may be lost at any moment now
    lose(cameras["left"])
    rig[0].plug()
    pairer.camera_restarted("left")
    start(cameras["left"], rig[0])
    before = len(pairs)
    for _ in range(10):
        exposure()
    assert len(pairs) >= before + 8
    for pair in pairs:
        assert pair.left.image[0, 0] == pair.right.image[0, 0]
