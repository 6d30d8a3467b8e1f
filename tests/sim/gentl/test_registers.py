"""Features behave as a camera's: rounded, locked, one for each selector, kept until the power goes."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from sim.gentl.cable import Cable
from sim.gentl.features import OLD_NAMES
from tests.sim.gentl.host import WAIT_S, opened

Cables = Callable[..., Cable]
TRIGGERS = "AcquisitionStart", "FrameBurstStart", "FrameStart"
LINES = "Line0", "Line1", "Line2"


def test_the_camera_reports_its_identity(producer: Path, cable: Cables) -> None:
    camera = cable(serial="22334455", model="Model C", size=(64, 48))
    camera.set_temperature(51.25)
    with opened(producer, "22334455") as (host,):
        names = "VendorName", "ModelName", "SerialNumber", "FirmwareVersion"
        assert [host.get(f"Device{name}") for name in names] == ["Fringed", "Model C", "22334455", "1.0"]
        assert host.get("DeviceTemperature") == 51.25
        host.set(DeviceUserID="left")
        assert host.get("DeviceUserID") == "left"


@pytest.mark.parametrize(("asked_us", "taken_us"), [(1234.56, 1230.0), (5.0 * 7, 40.0), (10.0, 10.0), (99_999, 1e5)])
def test_the_exposure_time_is_rounded_to_the_sensors_step(
    producer: Path, cable: Cables, asked_us: float, taken_us: float
) -> None:
    camera = cable(exposure_step_us=10.0)
    with opened(producer, "CAM0") as (host,):
        host.set(ExposureTime=asked_us)
        assert host.get("ExposureTime") == camera.state().exposure_us == taken_us


def test_each_selector_has_settings_of_its_own(producer: Path, cable: Cables) -> None:
    cable()
    with opened(producer, "CAM0") as (host,):
        settings = {
            selector: (mode, source, edge, float(100 * number))
            for number, (selector, mode, source, edge) in enumerate(
                zip(TRIGGERS, ("On", "Off", "On"), LINES, ("AnyEdge", "RisingEdge", "FallingEdge"), strict=True)
            )
        }
        names = "TriggerMode", "TriggerSource", "TriggerActivation", "TriggerDelay"
        for order in itertools.permutations(TRIGGERS):
            for selector in order:
                host.set(TriggerSelector=selector, **dict(zip(names, settings[selector], strict=True)))
            for selector in TRIGGERS:
                host.set(TriggerSelector=selector)
                assert tuple(host.get(name) for name in names) == settings[selector]
        for line in LINES:
            host.set(LineSelector=line, LineMode="Output" if line == "Line2" else "Input", LineInverter=line == "Line1")
        for line in LINES:
            host.set(LineSelector=line)
            assert (host.get("LineMode") == "Output", host.get("LineInverter")) == (line == "Line2", line == "Line1")
            assert host.get("LineStatus") is (line == "Line1"), "low lines, one of them inverted"


@pytest.mark.parametrize(
    ("name", "value"), [("Width", 32), ("Height", 16), ("PixelFormat", "Mono12"), ("ChunkModeActive", True)]
)
def test_what_sizes_the_buffers_is_locked_while_acquiring(
    producer: Path, cable: Cables, name: str, value: object
) -> None:
    cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.start()
        with pytest.raises(Exception, match=name):
            host.set(**{name: value})
        host.set(TLParamsLocked=0)
        with pytest.raises(Exception, match="locked while acquiring"):
            host.set(**{name: value})  # past GenApi's lock; the camera itself refuses
        host.stop()
        host.set(**{name: value})
        assert host.get(name) == value


def test_settings_outlive_the_program_but_not_the_power(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on("Line2")
        host.set(ExposureTime=777.0, Width=16)
        host.start()
    assert not camera.state().acquiring
    with opened(producer, "CAM0") as (host,):
        assert (host.get("TriggerSource"), host.get("ExposureTime"), host.get("Width")) == ("Line2", 777.0, 16)
        assert host.get("TLParamsLocked") == 0
    camera.unplug()
    camera.plug()
    with opened(producer, "CAM0") as (host,):
        assert (host.get("TriggerSource"), host.get("ExposureTime"), host.get("Width")) == ("Software", 5000.0, 48)


def test_the_factorys_settings_can_be_loaded(producer: Path, cable: Cables) -> None:
    cable()
    with opened(producer, "CAM0") as (host,):
        host.trigger_on("Line2")
        host.set(DeviceUserID="left", ExposureTime=777.0)
        host.nodes.UserSetLoad.execute()
        assert (host.get("TriggerMode"), host.get("ExposureTime"), host.get("DeviceUserID")) == ("Off", 5000.0, "left")
        host.start()
        with pytest.raises(Exception, match="UserSetLoad"):
            host.nodes.UserSetLoad.execute()


def test_the_clock_can_be_latched(producer: Path, cable: Cables) -> None:
    camera = cable()
    camera.set_clock(offset_ns=10**15, drift_ppm=500.0)
    with opened(producer, "CAM0") as (host,):
        before = camera.device_ns(time.monotonic_ns())
        host.nodes.TimestampLatch.execute()
        after = camera.device_ns(time.monotonic_ns())
        assert before <= host.get("TimestampLatchValue") <= after


def test_drift_shows_in_the_timestamps(producer: Path, cable: Cables) -> None:
    camera = cable()
    camera.set_clock(drift_ppm=100.0)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.start()
        t_ns = time.monotonic_ns()
        for later in (0, 10**9):
            assert camera.pulse(t_ns + later)
            assert camera.wait_idle(WAIT_S)
        first, second = (capture.timestamp for capture in host.captures(2))
        assert abs(second - first - 1_000_100_000) <= 1


def test_the_old_model_has_the_old_names_and_a_clock_in_ticks(producer: Path, cable: Cables) -> None:
    camera = cable(old=True)
    with opened(producer, "CAM0") as (host,):
        for new, old in OLD_NAMES.items():
            assert (host.nodes.has_node(new), host.nodes.has_node(old)) == (False, True)
        for missing in "ChunkModeActive", "DeviceTemperature":
            assert not host.nodes.has_node(missing)
        assert host.get("GevTimestampTickFrequency") == 125_000_000
        host.set(ExposureTimeAbs=2000.0)
        assert camera.state().exposure_us == 2000.0
        host.trigger_on()
        host.start()
        t_ns = time.monotonic_ns()
        assert camera.pulse(t_ns)
        (capture,) = host.captures(1)
        assert (capture.frame_id, capture.timestamp) == (1, camera.device_ns(t_ns) // 8)


def test_the_old_models_frame_numbers_have_16_bits_and_no_zero(producer: Path, cable: Cables) -> None:
    camera = cable(old=True, size=(16, 4))
    with opened(producer, "CAM0") as (host,):
        host.stream.StreamBufferHandlingMode.value = "NewestOnly"
        host.trigger_on()
        host.start()
        for number in range(1, 65538):
            assert camera.pulse()
            if number in (65535, 65536, 65537):
                assert camera.wait_idle(WAIT_S)
                assert host.captures(1)[0].frame_id == (number if number < 65536 else number - 65535)
        assert camera.state().delivered == 65537


@pytest.mark.parametrize(
    ("mode", "kept", "state"),
    [
        ("OldestFirst", [0, 1, 2], ("no_buffer", 4)),
        ("OldestFirstOverwrite", [4, 5, 6], ("superseded", 4)),
        ("NewestOnly", [6], ("superseded", 6)),
    ],
)
def test_the_stream_keeps_frames_by_its_buffer_handling_mode(
    producer: Path, cable: Cables, mode: str, kept: list[int], state: tuple[str, int]
) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        host.stream.StreamBufferHandlingMode.value = mode
        host.trigger_on()
        host.start(buffers=3)
        for _ in range(7):
            assert camera.pulse()
            assert camera.wait_idle(WAIT_S)
        assert [capture.frame_id for capture in host.captures(len(kept))] == kept
        assert host.nothing_comes()
        assert getattr(camera.state(), state[0]) == state[1]
        lost = host.stream.StreamLostFrameCount.value
        assert lost == camera.state().no_buffer
