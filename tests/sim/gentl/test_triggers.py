"""Every pulse has one result, and every exposure one end."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.gentl.cable import Cable, CableState
from sim.gentl.memory import MAX_PENDING
from tests.sim.gentl.host import WAIT_S, Host, opened

MS = 1_000_000
Cables = Callable[..., Cable]


def results(state: CableState) -> int:
    """How many pulses were answered."""
    return state.exposed + state.missed + state.ignored + state.granted


def ends(state: CableState) -> int:
    """How many exposures have ended."""
    lost = state.dropped + state.no_buffer + state.overrun + state.overwritten + state.abandoned
    return state.delivered + state.truncated + state.too_small + lost


def pulsed(cable: Cable, *, t_ns: int | None = None, **options: int) -> None:
    """A pulse, and all that it causes."""
    assert cable.pulse(t_ns, **options)
    assert cable.wait_idle(WAIT_S)


@pytest.mark.parametrize("seed", range(3))
def test_every_pulse_is_a_frame_or_counted_with_its_reason(producer: Path, cable: Cables, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = cable(readout_us=1000.0)
    camera.set_clock(offset_ns=5_000_000_000, drift_ppm=-40.0)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=3000.0)
        host.start(buffers=4)
        t_ns, free_ns, frame_id, wanted, missed, incomplete = time.monotonic_ns(), 0, 0, [], 0, 0
        for _ in range(150):
            t_ns += int(rng.integers(MS // 2, 6 * MS))
            fault = rng.choice(["none", "drop", "truncate"], p=[0.8, 0.1, 0.1])
            in_time = t_ns >= free_ns
            if in_time and fault != "none":
                getattr(camera, fault)()
            pulsed(camera, t_ns=t_ns)
            if not in_time:
                missed += 1
                continue
            free_ns = t_ns + 3 * MS
            if fault == "none":
                wanted.append((frame_id, camera.device_ns(t_ns)))
                capture = host.captures(1)[0]
                assert (capture.frame_id, capture.timestamp) == wanted[-1]
            incomplete += fault == "truncate"
            frame_id += 1
            assert fault == "none" or host.nothing_comes()
        state = camera.state()
        assert (results(state), ends(state)) == (150, state.exposed)
        assert (state.delivered, state.missed, state.exposed) == (len(wanted), missed, frame_id)
        assert (state.truncated, host.incomplete) == (incomplete, incomplete)
        assert missed > 10
        assert state.dropped > 3


def test_a_frame_leaves_after_exposure_and_readout_and_bears_the_time_of_its_pulse(
    producer: Path, cable: Cables
) -> None:
    camera = cable(real_time=True, readout_us=5000.0)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=20_000.0)
        host.start()
        t_ns = time.monotonic_ns()
        assert camera.pulse(t_ns)
        (capture,) = host.captures(1)
        assert time.monotonic_ns() - t_ns >= 25 * MS
        assert capture.timestamp == camera.device_ns(t_ns)


def test_pulses_during_the_exposure_are_missed_and_counted(producer: Path, cable: Cables) -> None:
    camera = cable(real_time=True)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=50_000.0)
        host.start()
        t_ns = time.monotonic_ns()
        for later in (0, 1, 49, 50):
            assert camera.pulse(t_ns + later * MS)
        captures = host.captures(2)
        assert [capture.timestamp for capture in captures] == [camera.device_ns(t_ns), camera.device_ns(t_ns + 50 * MS)]
        assert camera.wait_idle(WAIT_S)
        assert camera.state().missed == host.get("TriggersMissed") == 2


def test_a_pulse_may_be_given_ahead_of_its_time(producer: Path, cable: Cables) -> None:
    camera = cable(real_time=True)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=100.0)
        host.start()
        t_ns = time.monotonic_ns() + 100 * MS
        assert camera.pulse(t_ns)
        (capture,) = host.captures(1)
        assert time.monotonic_ns() >= t_ns
        assert capture.timestamp == camera.device_ns(t_ns)


def test_pulses_of_the_future_are_limited(producer: Path, cable: Cables) -> None:
    camera = cable(real_time=True)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.start()
        later_ns = time.monotonic_ns() + 3600 * 10**9
        given = 0
        while camera.pulse(later_ns + given):
            given += 1
            assert given <= MAX_PENDING
        assert given == MAX_PENDING
    assert camera.state().exposed == 0


def test_pulses_above_the_frame_rate_limit_are_missed(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(AcquisitionFrameRateEnable=True, AcquisitionFrameRate=30.0, ExposureTime=100.0)
        host.start()
        t_ns = time.monotonic_ns()
        for k in range(4):
            pulsed(camera, t_ns=t_ns + k * 20 * MS)
        assert len(host.captures(2)) == 2
        assert (camera.state().exposed, camera.state().missed) == (2, 2)


@pytest.mark.parametrize(
    ("settings", "line", "frames"),
    [
        ({}, 1, 1),
        ({}, 2, 0),
        ({"TriggerSource": "Line2"}, 2, 1),
        ({"LineSelector": "Line1", "LineMode": "Output"}, 1, 0),
        ({"LineSelector": "Line1", "LineInverter": True}, 1, 1),
        ({"TriggerActivation": "FallingEdge"}, 1, 1),
        ({"TriggerSource": "Software"}, 1, 0),
        ({"TriggerMode": "Off", "TriggerSelector": "AcquisitionStart", "TriggerMode2": "On"}, 1, 0),
    ],
)
def test_the_settings_decide_whether_a_pulse_exposes(
    producer: Path, cable: Cables, settings: dict[str, object], line: int, frames: int
) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        for name, value in settings.items():
            host.set(**{name.rstrip("2"): value})
        host.start()
        pulsed(camera, line=line)
        state = camera.state()
        assert (state.exposed, state.ignored) == (frames, 1 - frames)


def test_the_time_of_exposure_is_the_selected_edge_plus_its_delay(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on(activation="FallingEdge")
        host.set(TriggerDelay=250.0)
        host.start()
        t_ns = time.monotonic_ns()
        pulsed(camera, t_ns=t_ns, width_ns=70_000)
        assert host.captures(1)[0].timestamp == camera.device_ns(t_ns + 70_000 + 250_000)


def test_both_edges_give_a_frame_each(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on(activation="AnyEdge")
        host.set(ExposureTime=100.0)
        host.start()
        t_ns = time.monotonic_ns()
        pulsed(camera, t_ns=t_ns, width_ns=8 * MS)
        assert [s.timestamp for s in host.captures(2)] == [camera.device_ns(t_ns), camera.device_ns(t_ns + 8 * MS)]


def test_exposure_by_the_width_of_the_pulse(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureMode="TriggerWidth")
        host.chunks_on()
        host.start()
        pulsed(camera, width_ns=1_234_000)
        assert host.captures(1)[0].chunks["ExposureTime"] == 1234.0


def test_another_trigger_left_on_blocks_the_frames_until_it_comes(producer: Path, cable: Cables) -> None:
    """A program gets no notice of a selector that an earlier one has left on."""
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on("Line2", selector="AcquisitionStart")
        host.trigger_on("Line0", selector="FrameBurstStart")
        host.set(AcquisitionBurstFrameCount=2)
        host.trigger_on()
        host.start()
        assert not camera.state().armed
        for line in (1, 0, 2, 1, 0):
            pulsed(camera, line=line)
        assert camera.state().armed
        for line in (1, 1, 1, 0, 1):
            pulsed(camera, line=line)
        state = camera.state()
        assert (state.granted, state.exposed, state.ignored) == (3, 3, 4)


def test_a_burst_trigger_alone_gives_so_many_frames(producer: Path, cable: Cables) -> None:
    camera = cable(readout_us=100.0)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on("Line1", selector="FrameBurstStart")
        host.set(AcquisitionBurstFrameCount=3, ExposureTime=100.0)
        host.start()
        for burst in range(2):
            pulsed(camera)
            assert [capture.frame_id for capture in host.captures(3)] == [3 * burst + k for k in range(3)]
            assert camera.wait_idle(WAIT_S)
            assert host.nothing_comes()
        assert camera.state().granted == 2


def test_software_triggers_work_with_each_selector(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on("Software", selector="AcquisitionStart")
        host.trigger_on("Software")
        host.start()
        assert not camera.state().armed
        host.nodes.TriggerSoftware.execute()
        host.set(TriggerSelector="AcquisitionStart")
        host.nodes.TriggerSoftware.execute()
        host.set(TriggerSelector="FrameStart")
        host.nodes.TriggerSoftware.execute()
        assert len(host.captures(1)) == 1
        state = camera.state()
        assert (state.ignored, state.granted, state.exposed) == (1, 1, 1)


@pytest.mark.parametrize(("mode", "frames"), [("SingleFrame", 1), ("MultiFrame", 3)])
def test_an_acquisition_of_so_many_frames_ends_by_itself(producer: Path, cable: Cables, mode: str, frames: int) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(AcquisitionMode=mode, AcquisitionFrameCount=3)
        host.start()
        for _ in range(5):
            pulsed(camera)
        state = camera.state()
        assert (state.delivered, state.ignored, state.acquiring) == (frames, 5 - frames, False)


def test_a_camera_without_triggers_runs_free(producer: Path, cable: Cables, image: NDArray[np.uint8]) -> None:
    camera = cable(real_time=True)
    camera.show(image)
    with opened(producer, "CAM0") as (host,):
        host.set(ExposureTime=1000.0, PixelFormat="RGB8", AcquisitionFrameRateEnable=True, AcquisitionFrameRate=200.0)
        host.start()
        captures = host.captures(5)
        assert [capture.frame_id for capture in captures] == list(range(5))
        assert all(capture.bytes == image.tobytes() for capture in captures)
        gaps_ns = np.diff([capture.timestamp for capture in captures])
        assert gaps_ns.min() >= 5 * MS


def test_pulses_before_the_start_are_ignored(producer: Path, cable: Cables) -> None:
    camera = cable()
    assert not camera.pulse()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        pulsed(camera)
        assert (camera.state().ignored, camera.state().armed) == (1, False)
        host.start()
        assert camera.state().armed
        stopped(host, camera)
    assert not camera.pulse()


def stopped(host: Host, camera: Cable) -> None:
    """Stop, and a pulse has no effect any more."""
    host.stop()
    pulsed(camera)
    assert (camera.state().exposed, camera.state().ignored) == (0, 2)
