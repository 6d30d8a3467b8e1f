"""The simulated devices follow the protocols of the real ones."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from drivers.errors import DriverError, SettingRefused
from drivers.protocols import SIDES, Camera, Projector
from pipeline.pattern import color_fringe
from pipeline.rig import calibration
from pipeline.rig.volume import Volume
from sim.devices.clock import SteppedClock
from sim.devices.open_rig import open_rig

OPTIONS = {"scene": "plane", "frames": 2, "layout": {"scale": 0.0625}, "rate_hz": 0}


@pytest.fixture
def rig(tmp_path):
    devices = open_rig({**OPTIONS, "cache_dir": str(tmp_path)}, clock=SteppedClock(), keep_entries=True)
    yield devices
    devices.close()


def test_devices_implement_the_protocols(rig):
    assert set(rig.cameras) == set(SIDES)
    assert all(isinstance(camera, Camera) for camera in rig.cameras.values())
    assert isinstance(rig.projector, Projector)


def test_a_camera_reports_its_information(rig):
    info = rig.cameras["left"].open()
    assert (info.model, info.serial, info.size, info.encoding) == ("simulated", "sim-left", (64, 51), "rgb8")


def test_frames_are_read_only_images_of_the_loop(rig):
    camera = rig.cameras["left"]
    camera.open()
    camera.start()
    for _ in range(3):
        rig.trigger.step()
    frames = [camera.read(0.0) for _ in range(3)]
    assert [frame.trigger for frame in frames] == [0, 1, 2]
    assert all(frame.image.shape == (51, 64, 3) and frame.side == "left" for frame in frames)
    assert np.array_equal(frames[0].image, frames[2].image)
    assert not np.array_equal(frames[0].image, frames[1].image)
    with pytest.raises(ValueError, match="read-only"):
        frames[0].image[0, 0, 0] = 1


@pytest.mark.parametrize("calls", [["start"], ["open", "open"], ["open", "start", "start"], ["open", "start", "open"]])
def test_calls_out_of_order_are_refused_by_name(calls, rig):
    camera = rig.cameras["right"]
    for call in calls[:-1]:
        getattr(camera, call)()
    with pytest.raises(DriverError, match=f"camera right: {calls[-1]}"):
        getattr(camera, calls[-1])()


def test_reading_needs_a_started_camera(rig):
    camera = rig.cameras["left"]
    with pytest.raises(DriverError, match=r"read.. while closed"):
        camera.read(0.0)
    camera.open()
    with pytest.raises(DriverError, match=r"read.. while idle"):
        camera.read(0.0)


def test_nothing_in_time_is_none(rig):
    camera = rig.cameras["left"]
    camera.open()
    camera.start()
    assert camera.read(0.0) is None
    assert camera.read(0.001) is None


def test_an_idle_camera_ignores_triggers_and_stop_drops_what_waits(rig):
    camera = rig.cameras["left"]
    camera.open()
    rig.trigger.step()
    camera.start()
    rig.trigger.step()
    camera.stop()
    camera.start()
    rig.trigger.step()
    assert camera.read(0.0).trigger == 2
    assert camera.read(0.0) is None
    outcomes = [entry.outcome for entry in rig.trigger.ledger.entries if entry.side == "left"]
    assert outcomes == ["not_listening", "sent", "dropped", "sent"]


def test_a_full_queue_loses_its_oldest_frames_and_counts_them(rig):
    camera = rig.cameras["left"]
    camera.open()
    camera.start()
    for _ in range(11):
        rig.trigger.step()
    assert camera.read(0.0).trigger == 3
    assert camera.health().counters["overflow"] == 3
    assert rig.trigger.ledger.counts["left", "overflow"] == 3


def test_closing_twice_and_opening_again_is_fine(rig):
    camera = rig.cameras["left"]
    camera.open()
    camera.close()
    camera.close()
    camera.open()
    camera.start()
    rig.trigger.step()
    assert camera.read(0.0) is not None


def test_stop_wakes_a_waiting_reader(rig):
    camera = rig.cameras["left"]
    camera.open()
    camera.start()
    got = []
    reader = threading.Thread(target=lambda: got.append(camera.read(30.0)))
    reader.start()
    camera.stop()
    reader.join(timeout=10.0)
    assert not reader.is_alive()


def test_triggers_come_by_themselves_at_a_rate(tmp_path):
    rig = open_rig({**OPTIONS, "rate_hz": 500, "cache_dir": str(tmp_path)})
    try:
        for camera in rig.cameras.values():
            camera.open()
            camera.start()
        numbers = [rig.cameras["right"].read(20.0).trigger for _ in range(5)]
        assert numbers == sorted(numbers)
        assert rig.cameras["left"].read(20.0) is not None
    finally:
        rig.close()
    after = rig.trigger.triggers
    rig.trigger.stop()
    assert rig.trigger.triggers == after


def test_a_dark_projector_makes_dark_images(rig):
    camera, projector = rig.cameras["left"], rig.projector
    camera.open()
    camera.start()
    image = color_fringe.from_mapping(rig.pattern).image()
    brightness = []
    for act in (projector.open, lambda: projector.show(image), lambda: projector.show(image * 0), projector.close):
        act()
        rig.trigger.step()
        brightness.append(int(camera.read(0.0).image.max()))
    assert brightness[0] == brightness[2] == brightness[3] == 4
    assert brightness[1] > 100


def test_the_projector_refuses_what_was_never_rendered(rig):
    with pytest.raises(DriverError, match=r"show.. while closed"):
        rig.projector.show(np.zeros((64, 80, 3), np.uint8))
    info = rig.projector.open()
    assert info.size == (80, 64)
    with pytest.raises(SettingRefused, match="does not fit"):
        rig.projector.show(np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(SettingRefused, match="cannot show another image"):
        rig.projector.show(np.full((64, 80, 3), 128, np.uint8))


def test_the_pattern_sent_through_the_known_response_is_the_one_rendered(tmp_path):
    options = {**OPTIONS, "frames": 1, "optics": {"preset": "realistic"}, "cache_dir": str(tmp_path)}
    rig = open_rig(options)
    known = calibration.from_mapping(rig.calibration)
    rig.projector.open()
    rig.projector.show(color_fringe.from_mapping(rig.pattern).image(known.response))
    assert rig.trigger.cameras["left"].size == known.left.size
    rig.close()


def test_the_files_of_a_rig_read_back_as_the_rig(rig):
    known = calibration.from_mapping(rig.calibration)
    true = rig.options.layout.calibration()
    assert known.right.translation == pytest.approx(true.right.translation)
    assert known.left_color.black == pytest.approx([4, 4, 4])
    assert rig.calibration["cameras"]["left"]["serial"] == "sim-left"
    assert color_fringe.from_mapping(rig.pattern).size == known.projector.size
    assert Volume(**rig.volume) == rig.options.layout.volume()
