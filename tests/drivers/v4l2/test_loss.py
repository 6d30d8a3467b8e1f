"""Loss and return of the device, and files that cannot be read, over a kernel of our own."""

from __future__ import annotations

import errno
import os
import threading

import pytest

from drivers.errors import DeviceLost, DriverError
from drivers.v4l2 import structs as v
from drivers.v4l2.camera import V4l2Camera
from drivers.v4l2.kernel import LinuxKernel
from drivers.v4l2.options import from_mapping
from tests.drivers.v4l2.cameras import GREY, made, opened, started
from tests.drivers.v4l2.fake import FakeKernel, exposure_controls


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


def test_a_bus_without_bandwidth_is_reported_with_a_remedy() -> None:
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
    ("number", "kind", "message"),
    [
        (errno.ENOENT, DeviceLost, "plug the camera in"),
        (errno.ENODEV, DeviceLost, "plug the camera in"),
        (errno.EACCES, DriverError, "group 'video'"),
        (errno.EMFILE, DriverError, "EMFILE"),
    ],
)
def test_a_file_that_cannot_be_opened_names_the_next_step(number: int, kind: type[Exception], message: str) -> None:
    kernel = FakeKernel()
    kernel.open_errors.append(number)
    with pytest.raises(DriverError, match=message) as caught:
        opened(kernel)
    assert type(caught.value) is kind


def test_a_camera_of_another_program_is_reported() -> None:
    kernel = FakeKernel()
    kernel.errors[v.S_FMT].append(errno.EBUSY)
    with pytest.raises(DriverError, match="used by another program"):
        opened(kernel)


@pytest.mark.parametrize(
    ("capabilities", "message"),
    [
        (v.CAP_VIDEO_CAPTURE_MPLANE | v.CAP_STREAMING, "multi-planar"),
        (v.CAP_STREAMING, "has no image capture"),
        (v.CAP_VIDEO_CAPTURE, "cannot map"),
    ],
)
def test_unsupported_devices_are_refused_with_a_message(capabilities: int, message: str) -> None:
    kernel = FakeKernel(capabilities=capabilities)
    with pytest.raises(DriverError, match=message):
        opened(kernel)
    assert not kernel.fds


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
    with pytest.raises(DriverError, match="querying its capabilities"):
        camera.open()
    camera = V4l2Camera("left", from_mapping("left", {"device": "/dev/not-there"}))
    with pytest.raises(DeviceLost, match="there is no /dev/not-there"):
        camera.open()
