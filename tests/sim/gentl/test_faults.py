"""What goes wrong with real cameras goes wrong here, on request, and is counted."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim.gentl.cable import Cable
from tests.sim.gentl.host import WAIT_S, Harvester, Host, IoException, opened

Cables = Callable[..., Cable]


def pulses(camera: Cable, count: int) -> None:
    """So many pulses, one after the other."""
    for _ in range(count):
        assert camera.pulse()
        assert camera.wait_idle(WAIT_S)


def armed(host: Host, *, buffers: int = 16) -> None:
    """Waiting for pulses on line 1."""
    host.trigger_on()
    host.set(ExposureTime=100.0)
    host.start(buffers)


def exposed(camera: Cable, count: int) -> None:
    """Wait until so many exposures have begun."""
    deadline = time.monotonic() + WAIT_S
    while camera.state().exposed < count:
        assert time.monotonic() < deadline, camera.state()
        time.sleep(0.001)


def serials(producer: Path) -> dict[str, int]:
    """Cameras that are listed, with their access status."""
    harvester = Harvester()
    try:
        harvester.add_file(str(producer))
        harvester.update()
        return {info.serial_number: info.access_status for info in harvester.device_info_list}
    finally:
        harvester.reset()


def test_frames_lost_on_the_cable_leave_a_gap_in_their_numbers(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        armed(host)
        pulses(camera, 1)
        camera.drop(2)
        pulses(camera, 4)
        assert [capture.frame_id for capture in host.captures(3)] == [0, 3, 4]
        assert (camera.state().dropped, camera.state().delivered, host.get("FramesSent")) == (2, 3, 5)


def test_truncated_frames_are_handed_over_as_incomplete(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        armed(host)
        camera.truncate()
        pulses(camera, 2)
        assert [capture.frame_id for capture in host.captures(1)] == [1]
        assert host.incomplete == camera.state().truncated == 1


def test_stalled_frames_come_late_in_order_until_the_cameras_memory_is_full(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        armed(host)
        camera.stall(3600)
        for _ in range(11):
            assert camera.pulse()
        exposed(camera, 11)
        assert host.nothing_comes()
        camera.stall(0)
        assert [capture.frame_id for capture in host.captures(8)] == list(range(8))
        assert camera.wait_idle(WAIT_S)
        assert camera.state().overrun == 3
        pulses(camera, 1)
        assert host.captures(1)[0].frame_id == 11


def test_without_a_queued_buffer_frames_are_lost_and_counted(producer: Path, cable: Cables) -> None:
    camera = cable()
    with opened(producer, "CAM0") as (host,):
        armed(host, buffers=3)
        pulses(camera, 5)
        assert [capture.frame_id for capture in host.captures(3)] == [0, 1, 2]
        assert (camera.state().no_buffer, host.stream.StreamLostFrameCount.value) == (2, 2)


def test_frames_of_an_ended_acquisition_are_abandoned(producer: Path, cable: Cables) -> None:
    camera = cable(real_time=True)
    with opened(producer, "CAM0") as (host,):
        armed(host)
        host.set(ExposureTime=10_000_000.0)
        assert camera.pulse()
        exposed(camera, 1)
        host.stop()
        assert camera.wait_idle(WAIT_S)
        assert (camera.state().exposed, camera.state().abandoned) == (1, 1)


def test_an_unplugged_camera_answers_nothing_and_leaves_the_list(producer: Path, cable: Cables) -> None:
    camera, other = cable(), cable(number=1)
    with opened(producer, "CAM0", "CAM1") as (host, neighbour):
        armed(host)
        armed(neighbour)
        camera.unplug()
        with pytest.raises(IoException):
            host.get("DeviceTemperature")
        assert not camera.pulse()
        assert host.nothing_comes()
        pulses(other, 1)
        assert len(neighbour.captures(1)) == 1
        camera.plug()
        with pytest.raises(IoException):
            host.get("DeviceTemperature")  # it is another connection now
    camera.unplug()
    assert set(serials(producer)) == {"CAM1"}
    camera.plug()
    assert set(serials(producer)) == {"CAM0", "CAM1"}


def test_after_plugging_in_the_clock_restarts_and_frames_arrive_again(producer: Path, cable: Cables) -> None:
    camera = cable()
    camera.set_clock(offset_ns=10**18)
    with opened(producer, "CAM0") as (host,):
        armed(host)
        pulses(camera, 3)
        assert host.captures(3)[0].timestamp >= 10**18
        camera.unplug()
        camera.plug()
        host.close()
    with opened(producer, "CAM0") as (host,):
        armed(host)
        pulses(camera, 1)
        (capture,) = host.captures(1)
        assert (capture.frame_id, capture.timestamp < 10**15) == (0, True)


def test_a_closed_cable_removes_its_camera(producer: Path, directory: Path) -> None:
    camera = Cable(directory, 0, serial="CAM0")
    with opened(producer, "CAM0") as (host,):
        camera.close()
        camera.close()
        with pytest.raises(IoException):
            host.get("Width")
        new = Cable(directory, 0, serial="NEW", real_time=False)
    with pytest.raises(ValueError, match="CAM0 is closed"):
        camera.pulse()
    with new, opened(producer, "NEW") as (host,):
        armed(host)
        pulses(new, 1)
        assert len(host.captures(1)) == 1


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"number": 8}, "camera number 8"),
        ({"size": (642, 480)}, "642 x 480"),
        ({"serial": ""}, "serial number"),
        ({"serial": "x" * 64}, "1 to 63 bytes"),
    ],
)
def test_an_invalid_camera_is_rejected(cable: Cables, wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cable(**wrong)


def test_a_number_is_taken_once(cable: Cables) -> None:
    cable()
    with pytest.raises(FileExistsError):
        cable(serial="OTHER")


def test_an_image_of_another_size_is_refused(cable: Cables) -> None:
    camera = cable(size=(64, 48))
    for wrong in np.zeros((64, 48), np.uint8), np.zeros((48, 64), np.float32), np.zeros((48, 64, 4), np.uint8):
        with pytest.raises(ValueError, match=r"takes \(48, 64\)"):
            camera.show(wrong)
