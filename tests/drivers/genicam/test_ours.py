"""The whole driver on emulated triggered cameras: settings, images to the byte, triggers, health."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import DeviceLost, SettingRefused
from drivers.genicam import discover
from drivers.genicam.formats import BY_NAME
from drivers.protocols import Camera, Frame
from sim.gentl.cable import Cable
from tests.drivers.genicam import producers
from tests.open_files import open_files
from tools.waiting import wait_until

Make = Callable[..., Camera]
Rig = tuple[Cable, Cable]
LINE = {"exposure_us": 2000.0, "pixel_format": "BayerRG8"}


@pytest.fixture
def make(ours: Path, opened: Make, rig: Rig) -> Make:  # noqa: ARG001 - the cameras must be there
    def camera(serial: str = "A1", **options: Any) -> Camera:
        side = "left" if serial == "A1" else "right"
        return opened({"producer": str(ours), "serial": serial, **LINE, **options}, side=side)

    return camera


def expose(cable: Cable, camera: Camera, **pulse: Any) -> Frame:
    """The frame of one pulse."""
    assert cable.wait_armed(5)
    assert cable.pulse(**pulse)
    frame = camera.read(5.0)
    assert frame is not None
    return frame


def image(cable: Cable, seed: int = 0, *, colour: bool = True) -> Any:
    width, height = cable.size
    shape = (height, width, 3) if colour else (height, width)
    shown = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    cable.show(shown)
    return shown


def mosaic(shown: Any, pattern: str = "RG") -> Any:
    """What a sensor with that filter sees of a colour image."""
    channels = {"RG": (0, 1, 1, 2), "GR": (1, 0, 2, 1), "GB": (1, 2, 0, 1), "BG": (2, 1, 1, 0)}[pattern]
    out = np.empty(shown.shape[:2], shown.dtype)
    for k, channel in enumerate(channels):
        out[k // 2 :: 2, k % 2 :: 2] = shown[k // 2 :: 2, k % 2 :: 2, channel]
    return out


def test_images_are_exact_and_belong_to_their_pulse(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make()
    info = camera.open()
    assert (info.serial, info.size, info.encoding, info.exposure_us, info.notes) == (
        "A1",
        (64, 48),
        "bayer_rggb8",
        2000.0,
        (),
    )
    camera.start()
    for k in range(10):
        shown = image(cable, k)
        at = time.monotonic_ns()
        real = time.time_ns()
        frame = expose(cable, camera, t_ns=at)
        assert frame.trigger == k
        assert (frame.image == mosaic(shown)).all()
        assert frame.exposure_us == 2000.0
        assert frame.t_device_ns == cable.device_ns(at)
        assert abs(frame.t_exposure_ns - real) < 1_000_000


FORMATS = [name for name in BY_NAME if name.startswith(("Mono", "BayerRG", "RGB8"))]
KINDS = "Mono8", "Mono16", "BayerRG12p", "RGB8"
"""One of each depth and colour, and one that is packed; the others are long, as test_formats unpacks all."""


@pytest.mark.parametrize(
    "name", [name if name in KINDS else pytest.param(name, marks=pytest.mark.long) for name in FORMATS]
)
def test_each_format_that_the_camera_has(make: Make, rig: Rig, name: str) -> None:
    cable, camera = rig[0], make(pixel_format=name)
    try:
        info = camera.open()
    except SettingRefused:
        assert "Packed" in name or name == "Mono14", "the emulated camera has all others"
        return
    camera.start()
    shown = image(cable, 1)
    frame = expose(cable, camera)
    pixels = BY_NAME[name]
    assert frame.encoding == info.encoding == pixels.encoding
    assert any("reduced to 8" in note for note in info.notes) == pixels.reduced
    if name == "RGB8":
        assert (frame.image == shown).all()
    elif name.startswith("Bayer"):
        assert np.abs(frame.image.astype(int) - mosaic(shown)).max() <= (pixels.depth > 8)
    else:
        cable.show(np.full(shown.shape[:2], 65535, np.uint16))
        assert expose(cable, camera).image.min() == (65535 if pixels.encoding == "mono16" else 255)
        cable.show(np.zeros_like(shown))
        assert expose(cable, camera).image.max() == 0


@pytest.mark.parametrize(
    "pattern", ["GB", *(pytest.param(name, marks=pytest.mark.long) for name in ("RG", "GR", "BG"))]
)
def test_each_filter(world: Path, ours: Path, opened: Make, pattern: Any) -> None:
    with Cable(world, 5, serial="B", size=(32, 16), sensor=pattern) as cable:
        camera = opened({"producer": str(ours), "serial": "B", "pixel_format": f"Bayer{pattern}8"})
        camera.open()
        camera.start()
        shown = image(cable)
        frame = expose(cable, camera)
        assert frame.encoding == BY_NAME[f"Bayer{pattern}8"].encoding
        assert (frame.image == mosaic(shown, pattern)).all()


def test_a_region_is_cut_out_of_the_image(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make(roi={"x": 8, "y": 4, "width": 32, "height": 20})
    info = camera.open()
    assert info.size == (32, 20)
    assert info.notes == ()
    camera.start()
    shown = image(cable)
    assert (expose(cable, camera).image == mosaic(shown)[4:24, 8:40]).all()


def test_a_region_off_the_steps_keeps_the_bayer_pattern_with_a_note(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make(roi={"x": 9, "y": 5, "width": 33, "height": 21})
    info = camera.open()
    assert info.size == (32, 20)
    assert set(info.notes) == {
        "roi.width 33 became 32",
        "roi.height 21 became 20",
        "roi.x 9 became 8",
        "roi.y 5 became 4",
    }
    camera.start()
    shown = image(cable)
    assert (expose(cable, camera).image == mosaic(shown)[4:24, 8:40]).all()


def test_without_a_region_the_whole_sensor_is_read_again(make: Make) -> None:
    small = make(roi={"width": 32, "height": 20, "x": 4, "y": 2})
    assert small.open().size == (32, 20)
    small.close()
    assert make().open().size == (64, 48)


def test_a_rounded_exposure_is_noted_and_a_wrong_one_refused(make: Make) -> None:
    assert make(exposure_us=1000.2).open().notes == ("exposure_us 1000.2 became 1000",)
    with pytest.raises(SettingRefused, match=r"exposure_us 1 became 10; 10 to 1e.07 us are possible"):
        make("A2", exposure_us=1.0).open()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trigger": {"line": "Line9"}}, "TriggerSource cannot be set to Line9: there are .*Line1"),
        pytest.param(
            {"trigger": {"selector": "LineStart"}},
            "TriggerSelector cannot be set to LineStart: there are .*FrameStart",
            marks=pytest.mark.long,
        ),
        ({"features": {"DeviceTemperature": 1.0}}, "DeviceTemperature cannot be set to 1.0: it is read-only"),
        pytest.param({"features": {"ExposureMode": "Magic"}}, "there are Timed, TriggerWidth", marks=pytest.mark.long),
    ],
)
def test_what_the_measurement_depends_on_is_refused(make: Make, options: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingRefused, match=message):
        make(**options).open()


def test_further_features_are_set(make: Make) -> None:
    info = make(features={"DeviceUserID": "left eye", "Gamma": 99.0}, gain=3.0).open()
    assert info.notes == ("features.Gamma 99.0 became 4.0",)


def test_a_camera_is_found_by_its_user_name(make: Make, ours: Path, opened: Make) -> None:
    camera = make(features={"DeviceUserID": "left eye"})
    camera.open()
    camera.close()
    if any(found.user_name == "left eye" for found in discover([ours])):
        assert opened({"producer": str(ours), "user_name": "left eye"}).open().serial == "A1"


def test_settings_left_in_a_camera_are_overwritten(make: Make, rig: Rig) -> None:
    mess = {
        "AcquisitionMode": "SingleFrame",
        "AcquisitionFrameRateEnable": True,
        "AcquisitionFrameRate": 1.0,
        "ExposureAuto": "Continuous",
        "GainAuto": "Continuous",
        "TriggerDelay": 500000.0,
        "TriggerSelector": "AcquisitionStart",
        "TriggerMode": "On",
        "LineSelector": "Line1",
        "LineInverter": True,
    }
    first = make(features=mess)
    first.open()
    first.close()
    cable, camera = rig[0], make()
    camera.open()
    camera.start()
    times = [expose(cable, camera).t_exposure_ns for _ in range(5)]
    assert max(np.diff(times)) < 900_000_000, "the frame rate limit is still on"


@pytest.mark.parametrize("edge", [pytest.param("rising", marks=pytest.mark.long), "falling"])
def test_the_edge_that_counts(make: Make, rig: Rig, edge: str) -> None:
    cable, camera = rig[0], make(trigger={"edge": edge}, exposure_us=100.0)
    camera.open()
    camera.start()
    at = time.monotonic_ns()
    frame = expose(cable, camera, t_ns=at, width_ns=20_000_000)
    late = frame.t_device_ns - cable.device_ns(at)  # type: ignore[operator]
    assert late == (0 if edge == "rising" else 20_000_000)


def test_delay_and_inverter(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make(trigger={"delay_us": 3000.0, "inverted": True}, exposure_us=100.0)
    camera.open()
    camera.start()
    at = time.monotonic_ns()
    frame = expose(cable, camera, t_ns=at, width_ns=10_000_000)
    assert frame.t_device_ns == cable.device_ns(at + 13_000_000)


def test_pulses_on_other_lines_are_not_seen(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make(trigger={"line": "Line2"})
    camera.open()
    camera.start()
    assert cable.wait_armed(5)
    cable.pulse(line=1)
    assert cable.wait_idle(5)
    assert expose(cable, camera, line=2).trigger == 0
    assert cable.state().ignored == 1


def test_the_stamp_may_be_of_another_moment(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make(timestamp_offset_us=-1500.0)
    camera.open()
    camera.start()
    at = time.monotonic_ns()
    assert expose(cable, camera, t_ns=at).t_device_ns == cable.device_ns(at) - 1_500_000


def test_two_cameras_agree_on_numbers_and_times(make: Make, rig: Rig) -> None:
    cameras = make("A1"), make("A2")
    for camera, cable in zip(cameras, rig, strict=True):
        camera.open()
        camera.start()
        assert cable.wait_armed(5)
    for k in range(30):
        at = time.monotonic_ns()
        assert all(cable.pulse(at) for cable in rig)
        left, right = (camera.read(5.0) for camera in cameras)
        assert left is not None and right is not None
        assert left.trigger == right.trigger == k
        assert (left.side, right.side) == ("left", "right")
        assert abs(left.t_exposure_ns - right.t_exposure_ns) < 1_000_000


def test_health_has_the_temperature_and_early_triggers(make: Make, rig: Rig) -> None:
    cable, camera = rig[0], make()
    cable.set_temperature(61.25)
    camera.open()
    camera.start()
    wait_until(lambda: camera.health().temperature_c == 61.25)
    at = time.monotonic_ns()
    assert cable.wait_armed(5)
    for later in (0, 500_000, 1_000_000):
        cable.pulse(at + later)
    assert camera.read(5.0) is not None
    wait_until(lambda: camera.health().counters["missed_trigger"] == 2)
    assert expose(cable, camera).trigger == 1, "pulses that a camera ignores are not counted as frames"
    assert camera.health().counters["lost"] == 0


def test_old_cameras_count_ticks_of_their_own(world: Path, ours: Path, opened: Make) -> None:
    with producers.cables(world, old=True) as (cable, _):
        camera = opened({"producer": str(ours), "serial": "A1", "exposure_us": 500.0})
        camera.open()
        camera.start()
        for _ in range(3):
            at, real = time.monotonic_ns(), time.time_ns()
            frame = expose(cable, camera, t_ns=at)
            assert frame.t_device_ns is not None
            assert abs(frame.t_device_ns - cable.device_ns(at)) < 8
            assert abs(frame.t_exposure_ns - real) < 1_000_000


def test_listing_cameras_does_not_disturb_an_open_one(make: Make, rig: Rig, ours: Path) -> None:
    cable, camera = rig[0], make()
    camera.open()
    camera.start()
    found = {one.serial: one for one in discover([ours])}
    assert found["A1"].access in ("in use", "no access", "open")
    assert found["A2"].access == "free"
    assert found["A2"].transport == "Custom"
    assert expose(cable, camera).trigger == 0


def test_a_producer_that_does_not_load_is_reported(opened: Make, tmp_path: Path) -> None:
    broken = tmp_path / "broken.cti"
    broken.write_bytes(b"not a library")
    with pytest.raises(DeviceLost, match=r"no camera with serial 'X' through .*broken\.cti; there is none"):
        opened({"producer": str(broken), "serial": "X"}).open()
    assert discover([broken]) == []
    with pytest.raises(FileNotFoundError):
        discover([tmp_path / "none.cti"])


def test_without_a_temporary_directory_another_is_found(
    make: Make, rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if os.geteuid() == 0:
        # Root may write anywhere; a directory that does not exist stands for one that is closed to a service.
        monkeypatch.setenv("TMPDIR", "/nonexistent")
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    camera = make()
    camera.open()
    camera.start()
    assert expose(rig[0], camera).trigger == 0


@pytest.mark.parametrize("openings", [3, pytest.param(30, marks=pytest.mark.long)])
def test_nothing_grows_by_starting_and_opening_again(make: Make, rig: Rig, openings: int) -> None:
    cable, camera = rig[0], make()

    def held() -> tuple[int, int]:
        return open_files(), threading.active_count()

    before = None
    for _ in range(openings):
        camera.open()
        camera.start()
        expose(cable, camera)
        camera.stop()
        camera.close()
        before = before or held()
    assert held() == before
    camera.open()
    sizes = []
    for k in range(60):
        camera.start()
        expose(cable, camera)
        camera.stop()
        if k >= 20:
            sizes.append(_resident_kb(cable.state().open_by))
    assert sizes[-1] - sizes[0] < 4000, "the process grows with each start"


def _resident_kb(pid: int) -> int:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])
