"""The camera over a kernel of our own: the way of a frame, its time, the order of calls, every count."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.protocols import Camera
from drivers.v4l2 import structs as v
from drivers.v4l2.camera import COUNTERS
from tests.drivers.v4l2.cameras import GREY, counted, made, started
from tests.drivers.v4l2.fake import FakeKernel, exposure_controls


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


def test_a_frame_keeps_its_image_when_its_buffer_is_filled_again() -> None:
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

    image = np.full((16, 32, 3), (10, 200, 90), np.uint8)
    data = cv2.imencode(".jpg", image[..., ::-1])[1].tobytes()
    kernel = FakeKernel({"MJPG": [(32, 16)]})
    camera = started(kernel)
    kernel.expose(data[:80])
    kernel.expose(data)
    frame = camera.read(0)
    assert frame is not None and frame.encoding == "rgb8" and np.abs(frame.image.astype(int) - image).max() < 5
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


@pytest.mark.parametrize(
    ("flags", "used", "reason"), [(v.BUF_FLAG_ERROR, None, "error_frames"), (0, 511, "short_frames")]
)
def test_a_bad_frame_is_counted_and_passed_over(flags: int, used: int | None, reason: str) -> None:
    kernel = FakeKernel()
    camera = started(kernel)
    kernel.expose(GREY, flags=flags, used=used)
    kernel.expose(GREY)
    frame = camera.read(0)
    assert frame is not None and frame.trigger == 1
    assert counted(camera) == {"received": 1, reason: 1}


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


def test_calls_out_of_order_are_errors() -> None:
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


def test_stopping_drops_what_was_not_read_and_restarts_the_count() -> None:
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
