"""The kernel's own virtual camera: formats, controls, time stamps, and every fault that it can inject."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.v4l2 import discover
from drivers.v4l2.device import Device
from drivers.v4l2.kernel import LinuxKernel
from drivers.v4l2.stream import Stream
from tests.drivers.v4l2.guest.vivid_devices import MULTIPLANAR, SPARE, VIVID, acquiring, camera, push, read
from tools.waiting import wait_until

PLAIN = {"osd_text_mode": "none", "test_pattern": "100% Red"}


def refusal(kind: type[Exception], **options: Any) -> str:
    made = camera(VIVID, **options)
    try:
        made.open()
    except kind as error:
        return str(error)
    finally:
        made.close()
    raise AssertionError(f"{kind.__name__} was expected")


def test_discovery_lists_the_cameras_with_their_formats() -> None:
    found = {entry.node: entry for entry in discover()}
    assert found[VIVID].driver == "vivid" and not found[VIVID].problem
    assert {"YUYV", "GREY", "RGB3", "RGGB"} <= {form.fourcc for form in found[VIVID].formats}
    assert (320, 180) in found[VIVID].formats[0].sizes
    assert "multi-planar" in found[MULTIPLANAR].problem


def test_a_camera_is_found_by_its_bus() -> None:
    bus = {entry.node: entry.bus for entry in discover()}[SPARE]
    made = camera(bus)
    assert made.open().model == "vivid"
    made.close()


def test_a_multi_planar_camera_is_refused_with_a_message() -> None:
    try:
        camera(MULTIPLANAR).open()
    except DriverError as error:
        assert "multi-planar" in str(error)
    else:
        raise AssertionError("it was opened")


def test_pure_red_is_red_in_every_format() -> None:
    offered = {form.fourcc for entry in discover() if entry.node == VIVID for form in entry.formats}
    seen: dict[str, list[float]] = {}
    for form in ("RGB3", "BGR3", "YUYV", "UYVY"):
        with acquiring(format=form, controls=PLAIN) as made:
            image = read(made).image
        assert image.shape == (180, 320, 3) and not image.flags.writeable
        seen[form] = image.reshape(-1, 3).mean(0).tolist()
        assert np.abs(image.astype(int) - (255, 0, 0)).max() <= (0 if form in ("RGB3", "BGR3") else 6), seen
    rows = {"RGGB": (0, 0), "GRBG": (0, 1), "GBRG": (1, 0), "BA81": (1, 1)}
    for form, (row, column) in rows.items():
        for code in (form, {"RGGB": "RG10", "GRBG": "BA12", "GBRG": "GB16", "BA81": "BG10"}[form]):
            if code not in offered:
                assert code != form
                continue
            with acquiring(format=code, controls=PLAIN) as made:
                frame = read(made)
            lit = np.zeros((180, 320), np.uint8)
            lit[row::2, column::2] = 255
            assert np.abs(frame.image.astype(int) - lit).max() <= 1, (code, frame.image[:2, :2])
    assert frame.encoding == "bayer_bggr8"


def test_grey_formats_agree_and_fill_their_range() -> None:
    white = {**PLAIN, "test_pattern": "100% White"}
    for form, top in (("GREY", 255), ("Y16", 65535), ("Y10", 65535), ("Y12", 65535)):
        with acquiring(format=form, controls=white) as made:
            image = read(made).image
        assert image.dtype == (np.uint8 if top == 255 else np.uint16)
        assert image.min() >= 0.98 * top, (form, int(image.min()))
        with acquiring(format=form, controls={**PLAIN, "test_pattern": "100% Black"}) as made:
            assert read(made).image.max() <= 0.02 * top, form


def test_a_size_that_is_not_there_is_refused_with_those_there_are() -> None:
    assert "640x360" in refusal(SettingRefused, size=[322, 182], format="YUYV")


def test_a_format_that_is_not_there_is_refused_with_those_there_are() -> None:
    message = refusal(SettingRefused, format="MJPG")
    assert "YUYV" in message and "MJPG" in message


def test_a_control_that_is_not_there_is_refused_with_those_there_are() -> None:
    message = refusal(SettingRefused, controls={"brightnes": 3})
    assert "did you mean brightness?" in message and "contrast" in message


def test_a_menu_entry_that_is_not_there_is_refused_with_those_there_are() -> None:
    assert "100% Red" in refusal(SettingRefused, controls={"test_pattern": "purple"})


def test_a_clamped_control_is_a_note_with_the_value_it_took() -> None:
    made = camera(VIVID, controls={"brightness": 999})
    notes = made.open().notes
    made.close()
    assert any("999" in note and "uses 255" in note for note in notes), notes


def test_a_read_only_control_is_a_note() -> None:
    made = camera(VIVID, controls={"read_only_integer_32_bits": 3})
    notes = made.open().notes
    made.close()
    assert any("refused" in note for note in notes), notes


def test_a_frame_rate_that_was_rounded_is_a_note() -> None:
    made = camera(VIVID, frame_rate_hz=13.7)
    notes = made.open().notes
    made.close()
    assert any(note.startswith("frame_rate_hz: 13.7 was requested, the camera uses") for note in notes), notes


def test_frames_are_numbered_without_gaps_and_keep_their_bytes() -> None:
    with acquiring(format="GREY", controls={"test_pattern": "Noise"}, buffers=4) as made:
        first = read(made)
        kept = first.image.copy()
        frames = [first, *(read(made) for _ in range(11))]
        counters = made.health().counters
    missing = counters["kernel_dropped"]
    assert frames[-1].trigger - frames[0].trigger == 11 + missing - frames[0].trigger
    assert np.array_equal(first.image, kept) and not np.array_equal(frames[5].image, kept)
    assert counters["received"] == 12 and counters["error_frames"] == 0


def test_both_time_stamp_sources_give_the_start_of_exposure() -> None:
    for source in ("Start of Exposure", "End of Frame"):
        with acquiring(controls={"timestamp_source": source}) as made:
            before = time.time_ns()
            frames = [read(made) for _ in range(6)]
            after = time.time_ns()
        times = [frame.t_exposure_ns for frame in frames]
        assert times == sorted(times) and before - 10**9 < times[0] and times[-1] < after
        assert all(frame.t_exposure_ns <= frame.t_host_ns <= after for frame in frames)
    push({"timestamp_source": "End of Frame"})


def test_wrapped_time_stamps_fall_back_to_the_host_clock_and_are_counted() -> None:
    push({"wrap_timestamp": "64 Bit"})
    try:
        with acquiring() as made:
            frame = read(made)
            assert made.health().counters["without_timestamp"] == 1
        assert abs(time.time_ns() - frame.t_exposure_ns) < 30 * 10**9
    finally:
        push({"wrap_timestamp": "None"})


def test_a_wrapped_sequence_goes_on_counting() -> None:
    push({"wrap_sequence_number": True})
    try:
        with acquiring(frame_rate_hz=50.0) as made:
            frames = [read(made)]
            wait_until(lambda: frames.append(read(made)) or frames[-1].frame_id < 1000, what="the sequence wraps")
            frames += [read(made) for _ in range(3)]
            counters = made.health().counters
    finally:
        push({"wrap_sequence_number": False})
    assert frames[0].frame_id > 2**32 - 1000 and frames[0].trigger == 0
    assert counters["sequence_restarts"] == 0
    assert frames[-1].trigger == len(frames) - 1 + counters["kernel_dropped"]


def test_a_frame_with_the_error_flag_is_counted_and_passed_over() -> None:
    with acquiring() as made:
        read(made)
        push({"inject_v4l2_buf_flag_error": True})
        wait_until(
            lambda: read(made) and made.health().counters["error_frames"] == 1, what="the error frame is counted"
        )


def test_dropped_buffers_are_gaps_that_are_counted() -> None:
    push({"percentage_of_dropped_buffers": 50})
    try:
        with acquiring(frame_rate_hz=50.0) as made:
            last = [read(made) for _ in range(20)][-1]
            counters = made.health().counters
    finally:
        push({"percentage_of_dropped_buffers": 0})
    assert counters["kernel_dropped"] > 0
    assert last.trigger + 1 == counters["received"] + counters["kernel_dropped"]


def test_refused_buffers_and_a_refused_start_are_errors_and_the_next_try_succeeds() -> None:
    for fault in ("inject_vidioc_reqbufs_error", "inject_vidioc_streamon_error"):
        made = camera(VIVID)
        made.open()
        push({fault: True})
        try:
            made.start()
        except DriverError as error:
            assert VIVID in str(error)
        else:
            raise AssertionError(f"{fault}: it started")
        made.start()
        assert read(made)
        made.close()


def test_a_fatal_streaming_error_loses_the_camera_and_opening_again_recovers() -> None:
    with acquiring() as made:
        read(made)
        push({"inject_fatal_streaming_error": True})
        lost_and_found(made)


def test_an_unplugged_camera_is_lost_and_found_again() -> None:
    with acquiring() as made:
        read(made)
        push({"disconnect": True})
        lost_and_found(made)


def lost_and_found(made: Any) -> None:
    with contextlib.suppress(DeviceLost):
        wait_until(lambda: not read(made), what="the camera is lost")
    assert made.health().counters["lost_device"] == 1
    made.open()
    made.start()
    assert read(made).trigger < 100


def test_unplugged_while_idle_it_is_lost_at_the_start() -> None:
    made = camera(VIVID)
    made.open()
    push({"disconnect": True})
    try:
        made.start()
    except DeviceLost:
        made.open()
        made.close()
        return
    raise AssertionError("it started")


def test_stopping_and_starting_releases_the_buffers_and_restarts_the_count() -> None:
    with acquiring() as made:
        for _ in range(5):
            read(made)
            made.stop()
            made.start()
        assert read(made).trigger < 100


def test_a_camera_in_use_is_refused_with_a_message() -> None:
    with acquiring() as made:
        read(made)
        other = camera(VIVID, "right", size=[640, 360])
        try:
            other.open()
        except DriverError as error:
            assert "used by another program" in str(error)
        else:
            raise AssertionError("it was opened twice")
        finally:
            other.close()


def test_a_buffer_can_be_exported() -> None:
    device = Device(LinuxKernel(), VIVID, "camera left")
    device.set_format("GREY", (320, 180))
    stream = Stream(device, 4)
    try:
        fd = stream.export(0)
        assert os.fstat(fd).st_size >= 320 * 180 or os.lseek(fd, 0, os.SEEK_END) >= 320 * 180
        os.close(fd)
    finally:
        stream.close()
        device.close()


def descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def test_fifty_openings_leave_no_descriptor_behind() -> None:
    before = descriptors()
    for _ in range(50):
        made = camera(VIVID)
        made.open()
        made.start()
        made.close()
    assert descriptors() == before
