"""The camera over a kernel of our own: the order of calls, the loss and return of the device, every count."""

from __future__ import annotations

import errno
import os
import threading
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.protocols import Camera, CameraInfo
from drivers.v4l2 import structs as v
from drivers.v4l2.camera import COUNTERS, V4l2Camera
from drivers.v4l2.controls import Kind, normalised
from drivers.v4l2.kernel import LinuxKernel
from drivers.v4l2.options import from_mapping
from tests.drivers.v4l2.fake import PATH, FakeControl, FakeKernel, exposure_controls

GREY = bytes(range(32)) * 16


def made(kernel: FakeKernel, **options: Any) -> V4l2Camera:
    return V4l2Camera("left", from_mapping("left", {"device": PATH, **options}), kernel=kernel)


def opened(kernel: FakeKernel, **options: Any) -> CameraInfo:
    camera = made(kernel, **options)
    try:
        return camera.open()
    finally:
        camera.close()


def started(kernel: FakeKernel, **options: Any) -> V4l2Camera:
    camera = made(kernel, **options)
    camera.open()
    camera.start()
    return camera


def counted(camera: V4l2Camera) -> dict[str, int]:
    """What was counted, without the zeros."""
    return {name: count for name, count in camera.health().counters.items() if count}


# ---- the way of a frame


def test_a_frame_comes_as_it_was_exposed() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    assert isinstance(camera, Camera)
    before = time.time_ns()
    kernel.expose(GREY)
    frame = camera.read(0)
    assert frame is not None and frame.image.tobytes() == GREY and frame.image.shape == (16, 32)
    assert (frame.side, frame.trigger, frame.frame_id, frame.encoding) == ("left", 0, 0, "mono8")
    assert not frame.image.flags.writeable
    assert before - 10**6 <= frame.t_exposure_ns <= frame.t_host_ns <= time.time_ns() + 10**6
    assert camera.read(0) is None
    assert counted(camera) == {"received": 1}


def test_a_frame_keeps_its_picture_when_its_buffer_is_filled_again() -> None:
    kernel = FakeKernel(grant=2)
    camera = started(kernel)
    kernel.expose(GREY)
    first = camera.read(0)
    for _ in range(4):
        kernel.expose(bytes(512))
        camera.read(0)
    assert first is not None and first.image.tobytes() == GREY


def test_padding_of_rows_is_left_out() -> None:
    kernel = FakeKernel(row_padding=7)
    camera = started(kernel)
    kernel.expose(b"".join(GREY[i : i + 32] + b"\xee" * 7 for i in range(0, 512, 32)))
    frame = camera.read(0)
    assert frame is not None and frame.image.tobytes() == GREY


@pytest.mark.parametrize("grant", [2, 3, 8])
def test_fewer_buffers_than_asked_for_are_enough(grant: int) -> None:
    kernel = FakeKernel(grant=grant)
    camera = started(kernel, buffers=8)
    assert len(kernel.queued) == grant
    for i in range(3 * grant):
        kernel.expose(GREY)
        frame = camera.read(0)
        assert frame is not None and frame.trigger == i


def test_a_single_buffer_is_refused_and_nothing_stays_behind() -> None:
    kernel = FakeKernel(grant=1)
    camera = made(kernel)
    camera.open()
    with pytest.raises(DriverError, match="grants 1 of 8 buffers"):
        camera.start()
    assert not kernel.memories
    kernel.grant = 4
    camera.start()


@given(events=st.lists(st.sampled_from(["good", "error", "short", "starved", "skipped", "read"]), max_size=60))
@settings(deadline=None)
def test_every_frame_is_received_or_counted_with_a_reason(events: list[str]) -> None:
    kernel = FakeKernel(grant=3)
    camera = started(kernel)
    triggers: list[int] = []

    def read_all() -> None:
        while (frame := camera.read(0)) is not None:
            triggers.append(frame.trigger)

    for event in events:
        if event == "read":
            read_all()
        elif event == "starved":
            for _ in range(5):
                kernel.expose(GREY)
        else:
            flags = v.BUF_FLAG_ERROR if event == "error" else 0
            kernel.expose(GREY, flags=flags, used=100 if event == "short" else None, skip=4 * (event == "skipped"))
    read_all()
    kernel.expose(GREY)
    read_all()
    counts = camera.health().counters
    lost = counts["error_frames"] + counts["short_frames"] + counts["kernel_dropped"]
    assert counts["received"] + lost == triggers[-1] + 1 == kernel.sequence
    assert triggers == sorted(set(triggers)) and len(triggers) == counts["received"]
    assert set(counts) == set(COUNTERS)


def test_a_corrupt_jpeg_is_counted_and_passed_over() -> None:
    import cv2

    picture = np.full((16, 32, 3), (10, 200, 90), np.uint8)
    data = cv2.imencode(".jpg", picture[..., ::-1])[1].tobytes()
    kernel = FakeKernel({"MJPG": [(32, 16)]})
    camera = started(kernel)
    kernel.expose(data[:80])
    kernel.expose(data)
    frame = camera.read(0)
    assert frame is not None and frame.encoding == "rgb8" and np.abs(frame.image.astype(int) - picture).max() < 5
    assert counted(camera) == {"received": 1, "corrupt_jpeg": 1}


def test_a_sequence_that_went_back_is_counted() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    for number in (0, 1, 0):
        kernel.sequence = number
        kernel.expose(GREY)
        camera.read(0)
    assert counted(camera) == {"received": 3, "sequence_restarts": 1}


def test_woken_for_nothing_it_returns_none() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    kernel.wakes_for_nothing = 3
    assert camera.read(0) is None


# ---- time


@pytest.mark.parametrize(
    ("flags", "before_us"), [(v.BUF_FLAG_TSTAMP_SRC_SOE, 0), (0, 10_000 + 300)], ids=["start", "end"]
)
def test_the_exposure_is_taken_off_a_stamp_of_the_end(flags: int, before_us: int) -> None:
    kernel = FakeKernel(controls=exposure_controls(units=100))
    camera = started(kernel, end_of_frame_delay_us=300)
    stamp = time.monotonic_ns() // 1000 * 1000 - 5 * 10**6
    kernel.expose(GREY, flags=flags, timestamp_ns=stamp)
    frame = camera.read(0)
    offset_ns = time.time_ns() - time.monotonic_ns()
    assert frame is not None and frame.exposure_us == 10_000
    assert abs(frame.t_exposure_ns - (stamp + offset_ns - 1000 * before_us)) < 2 * 10**6


def test_stamps_of_the_realtime_clock_are_understood() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    stamp = time.time_ns() // 1000 * 1000
    kernel.expose(GREY, timestamp_ns=stamp)
    frame = camera.read(0)
    assert frame is not None and abs(frame.t_exposure_ns - stamp) < 2 * 10**6
    assert counted(camera) == {"received": 1}


def test_a_frame_without_a_stamp_takes_the_hosts_and_is_counted() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    kernel.expose(GREY, timestamp_ns=0)
    frame = camera.read(0)
    assert frame is not None and frame.t_exposure_ns == frame.t_host_ns
    assert counted(camera) == {"received": 1, "without_timestamp": 1}


# ---- loss and return


@pytest.mark.parametrize("moment", ["open", "start", "read", "stop"])
def test_unplugged_at_any_moment_it_is_lost_and_opens_again(moment: str) -> None:
    kernel = FakeKernel()
    camera = made(kernel)
    for step in ("open", "start", "read", "stop"):
        if step == moment:
            kernel.present = False
            with pytest.raises(DeviceLost):
                camera.read(0) if step == "read" else getattr(camera, step)()
            break
        camera.read(0) if step == "read" else getattr(camera, step)()
    assert not kernel.fds, "the descriptor is given back at once"
    assert camera.health().counters["lost_device"] == (0 if moment == "open" else 1)
    with pytest.raises(DeviceLost):
        camera.open()
    kernel.present = True
    camera.open()
    camera.start()
    kernel.expose(GREY)
    assert camera.read(0) is not None
    camera.close()


@pytest.mark.parametrize(
    "request_name", ["QUERYCAP", "G_FMT", "ENUM_FMT", "S_FMT", "G_PARM", "QUERY_EXT_CTRL", "S_CTRL"]
)
def test_unplugged_while_it_is_set_up_it_is_lost(request_name: str) -> None:
    kernel = FakeKernel(controls=exposure_controls(), rates_hz=(30,))
    kernel.errors[getattr(v, request_name)].append(errno.ENODEV)
    with pytest.raises(DeviceLost, match="was unplugged"):
        opened(kernel, frame_rate_hz=30, controls={"exposure_time_absolute": 5})
    assert not kernel.fds


@pytest.mark.parametrize("request_name", ["REQBUFS", "QUERYBUF", "QBUF", "STREAMON"])
@pytest.mark.parametrize("number", [errno.ENODEV, errno.EIO, errno.ENOMEM, errno.EBUSY])
def test_a_start_that_fails_leaves_nothing_behind_and_can_be_tried_again(request_name: str, number: int) -> None:
    kernel = FakeKernel()
    camera = made(kernel)
    camera.open()
    kernel.errors[getattr(v, request_name)].append(number)
    with pytest.raises(DriverError) as caught:
        camera.start()
    assert isinstance(caught.value, DeviceLost) == (number == errno.ENODEV)
    assert not kernel.memories and not kernel.streaming
    if number == errno.ENODEV:
        camera.open()
    camera.start()


def test_a_bus_without_bandwidth_is_told_with_what_helps() -> None:
    kernel = FakeKernel()
    camera = made(kernel)
    camera.open()
    kernel.errors[v.STREAMON].append(errno.ENOSPC)
    with pytest.raises(DriverError, match="different controllers"):
        camera.start()


def test_a_stream_that_the_driver_gave_up_is_a_lost_camera() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    kernel.broken = True
    with pytest.raises(DeviceLost, match="ended its stream"):
        camera.read(0)
    camera.open()
    camera.start()
    kernel.expose(GREY)
    assert camera.read(0) is not None


@pytest.mark.parametrize(
    ("number", "kind", "said"),
    [
        (errno.ENOENT, DeviceLost, "plug the camera in"),
        (errno.ENODEV, DeviceLost, "plug the camera in"),
        (errno.EACCES, DriverError, "group 'video'"),
        (errno.EMFILE, DriverError, "EMFILE"),
    ],
)
def test_a_file_that_cannot_be_opened_says_what_to_do(number: int, kind: type[Exception], said: str) -> None:
    kernel = FakeKernel()
    kernel.open_errors.append(number)
    with pytest.raises(DriverError, match=said) as caught:
        opened(kernel)
    assert type(caught.value) is kind


def test_a_camera_of_another_program_is_said_to_be_so() -> None:
    kernel = FakeKernel()
    kernel.errors[v.S_FMT].append(errno.EBUSY)
    with pytest.raises(DriverError, match="used by another program"):
        opened(kernel)


@pytest.mark.parametrize(
    ("capabilities", "said"),
    [
        (v.CAP_VIDEO_CAPTURE_MPLANE | v.CAP_STREAMING, "multi-planar"),
        (v.CAP_STREAMING, "gives no pictures"),
        (v.CAP_VIDEO_CAPTURE, "cannot map"),
    ],
)
def test_devices_that_cannot_be_read_are_refused_in_words(capabilities: int, said: str) -> None:
    kernel = FakeKernel(capabilities=capabilities)
    with pytest.raises(DriverError, match=said):
        opened(kernel)
    assert not kernel.fds


# ---- the order of calls


def test_calls_out_of_order_are_told() -> None:
    kernel = FakeKernel()
    camera = made(kernel)
    for wrong in (camera.start, lambda: camera.read(0)):
        with pytest.raises(DriverError, match="while it is closed"):
            wrong()
    camera.stop()
    camera.open()
    with pytest.raises(DriverError, match="read\\(\\) before start"):
        camera.read(0)
    with pytest.raises(DriverError, match="close\\(\\) it first"):
        camera.open()
    camera.start()
    with pytest.raises(DriverError, match="stop\\(\\) it first"):
        camera.start()
    camera.stop()
    camera.stop()
    camera.close()
    camera.close()
    assert not kernel.fds


def test_stopping_drops_what_was_not_read_and_counts_anew() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    for _ in range(3):
        kernel.expose(GREY)
    camera.stop()
    camera.start()
    kernel.expose(GREY)
    frame = camera.read(0)
    assert frame is not None and frame.trigger == 0
    assert camera.health().counters["kernel_dropped"] == 0


def test_memory_is_unmapped_when_it_stops() -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    memories = list(kernel.memories)
    camera.stop()
    assert all(memory.closed for memory in memories)


# ---- settings


def test_the_best_format_for_measuring_is_chosen() -> None:
    offered = {"MJPG": [(32, 16)], "GREY": [(32, 16)], "YUYV": [(32, 16)], "H264": [(32, 16)]}
    assert opened(FakeKernel(offered)).encoding == "rgb8"
    assert opened(FakeKernel({**offered, "GBRG": [(32, 16)]})).encoding == "bayer_gbrg8"
    assert opened(FakeKernel(offered), format="GREY").encoding == "mono8"
    notes = opened(FakeKernel({"RG12": [(32, 16)]})).notes
    assert any("12 bits are reduced to 8" in note for note in notes)


def test_formats_and_sizes_that_are_not_there_are_refused_with_those_there_are() -> None:
    kernel = FakeKernel({"GREY": [(32, 16), (64, 48)]})
    with pytest.raises(SettingRefused, match="GREY 32x16, 64x48"):
        opened(kernel, size=[640, 480])
    with pytest.raises(SettingRefused, match="does not offer the format YUYV; there are: GREY"):
        opened(kernel, format="YUYV")
    with pytest.raises(SettingRefused, match="none of the formats of Fake camera can be read: H264"):
        opened(FakeKernel({"H264": [(32, 16)]}))
    assert not kernel.fds


def test_switches_are_set_before_values() -> None:
    kernel = FakeKernel(controls=exposure_controls(mode=3))
    info = opened(kernel, controls={"exposure_time_absolute": 50, "auto_exposure": "manual mode"})
    assert kernel.set_order == ["Auto Exposure", "Exposure Time, Absolute"]
    assert info.exposure_us == 5000


@pytest.mark.parametrize("entry", ["manual", "Manual Mode", "manual_mode", 1])
def test_menus_take_names_and_numbers(entry: str | int) -> None:
    kernel = FakeKernel(controls=exposure_controls(mode=3))
    opened(kernel, controls={"auto_exposure": entry})
    assert kernel.controls[v.CID_EXPOSURE_AUTO].value == 1


@pytest.mark.parametrize("entry", ["bright", 2, "mode"])
def test_menu_entries_that_are_not_there_are_refused_with_those_there_are(entry: str | int) -> None:
    with pytest.raises(SettingRefused, match="Manual Mode \\(1\\)"):
        opened(FakeKernel(controls=exposure_controls()), controls={"auto_exposure": entry})


def test_an_unknown_control_is_refused_with_those_there_are() -> None:
    with pytest.raises(SettingRefused, match="did you mean exposure_time_absolute") as caught:
        opened(FakeKernel(controls=exposure_controls()), controls={"exposure_absolute": 5})
    assert "auto_exposure" in str(caught.value)


@pytest.mark.parametrize(
    ("control", "value", "said"),
    [
        (FakeControl(5, "Gain", value=7), 900, "the camera took 255; 0 to 255"),
        (FakeControl(5, "Gain", value=7, flags=v.CTRL_FLAG_READ_ONLY), 3, "refused (it can only be read"),
        (FakeControl(5, "Gain", value=7, flags=v.CTRL_FLAG_INACTIVE), 3, "makes it inactive"),
    ],
)
def test_what_the_camera_did_otherwise_is_a_note(control: FakeControl, value: int, said: str) -> None:
    notes = opened(FakeKernel(controls=[control]), controls={"gain": value}).notes
    assert any(said in note for note in notes), notes


@pytest.mark.parametrize("number", [errno.EBUSY, errno.ERANGE, errno.EINVAL, errno.EIO, errno.EPIPE])
def test_a_refused_control_is_a_note_with_the_value_it_has(number: int) -> None:
    kernel = FakeKernel(controls=[FakeControl(5, "Gain", value=7)])
    kernel.errors[v.S_CTRL].append(number)
    notes = opened(kernel, controls={"gain": 3}).notes
    assert any("gain: 3 was refused" in note and "it is 7" in note for note in notes), notes


def test_controls_of_all_kinds_are_set() -> None:
    kernel = FakeKernel(
        controls=[
            FakeControl(1, "Trigger Mode", Kind.BOOLEAN, 0, 1),
            FakeControl(2, "Power Line", Kind.INTEGER_MENU, 0, 2, menu={0: "0", 1: "50", 2: "60"}),
            FakeControl(3, "Mask", Kind.BITMASK, 0, 255),
        ]
    )
    info = opened(kernel, controls={"trigger_mode": True, "power_line": "60", "mask": 5})
    assert [control.value for control in kernel.controls.values()] == [1, 2, 5]
    assert info.notes == ()


def test_the_frame_rate_that_it_took_is_a_note_unless_it_is_the_one_asked_for() -> None:
    assert not any("frame_rate" in note for note in opened(FakeKernel(rates_hz=(15, 30)), frame_rate_hz=30).notes)
    notes = opened(FakeKernel(rates_hz=(15, 30)), frame_rate_hz=25).notes
    assert "frame_rate_hz: 25 was asked, the camera took 30" in notes
    assert any("takes no frame rate" in note for note in opened(FakeKernel(), frame_rate_hz=25).notes)


def test_an_automatic_exposure_is_unknown_and_told() -> None:
    info = opened(FakeKernel(controls=exposure_controls(mode=3)))
    assert info.exposure_us == 0 and any("automatic" in note for note in info.notes)


def test_how_it_is_triggered_is_told() -> None:
    trigger = [FakeControl(1, "Trigger Mode", Kind.BOOLEAN, 0, 1)]
    assert any("set trigger_mode in controls" in note for note in opened(FakeKernel(controls=trigger)).notes)
    assert opened(FakeKernel(controls=trigger), controls={"trigger_mode": True}).notes == ()
    assert any("none of its controls" in note for note in opened(FakeKernel()).notes)
    still = opened(FakeKernel(), trigger="software", only_still_scenes=True)
    assert any("by chance only" in note for note in still.notes)


@given(name=st.text(max_size=40))
def test_names_are_letters_digits_and_single_underscores(name: str) -> None:
    short = normalised(name)
    assert normalised(short) == short
    assert not short.startswith("_") and "__" not in short and short == short.lower()


def test_names_are_those_of_v4l2_ctl() -> None:
    assert normalised("White Balance Temperature, Auto") == "white_balance_temperature_auto"
    assert normalised("Exposure (Absolute)") == "exposure_absolute"


# ---- the real kernel, as far as it can be had without a camera


def test_waiting_ends_in_time_or_with_data_and_lets_other_threads_run() -> None:
    end, start = os.pipe()
    try:
        kernel = LinuxKernel()
        assert not kernel.wait(end, 0.01)
        thread = threading.Thread(target=lambda: os.write(start, b"x"))
        thread.start()
        assert kernel.wait(end, 30)
        thread.join()
    finally:
        os.close(end)
        os.close(start)


def test_a_file_that_is_no_camera_is_refused() -> None:
    camera = V4l2Camera("left", from_mapping("left", {"device": "/dev/null"}))
    with pytest.raises(DriverError, match="asking what it is"):
        camera.open()
    camera = V4l2Camera("left", from_mapping("left", {"device": "/dev/not-there"}))
    with pytest.raises(DeviceLost, match="there is no /dev/not-there"):
        camera.open()
