"""Which cameras are found, in a system's directories that the test makes."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import DeviceLost, DriverError
from drivers.v4l2 import discover
from drivers.v4l2 import structs as v
from drivers.v4l2.discovery import resolve, serial_of
from tests.drivers.v4l2.fake import PATH, FakeKernel


class Machine(FakeKernel):
    """Several device files, all of the one fake camera."""

    def __init__(self, dev: Path, **capabilities: int) -> None:
        super().__init__({"YUYV": [(640, 480), (32, 16)], "GREY": [(32, 16)]})
        self.by_node = {str(dev / name): value for name, value in capabilities.items()}

    def open(self, path: str) -> int:
        self.capabilities = self.by_node.get(path, 0)
        return super().open(PATH if path in self.by_node else path)


@pytest.fixture
def system(tmp_path: Path) -> tuple[Path, Path]:
    """(sysfs, dev) with a USB camera video0, its metadata file video1, a multi-planar video2 and a dead video10."""
    sysfs, dev, usb = tmp_path / "class", tmp_path / "dev", tmp_path / "devices" / "usb1" / "1-2"
    (usb / "1-2:1.0").mkdir(parents=True)
    (usb / "serial").write_text("SN-0042\n")
    bare = tmp_path / "devices" / "platform"
    bare.mkdir()
    for name, device in (("video0", usb / "1-2:1.0"), ("video1", usb / "1-2:1.0"), ("video2", bare), ("video10", bare)):
        (sysfs / name).mkdir(parents=True)
        (sysfs / name / "name").write_text(f"the {name}\n")
        (sysfs / name / "device").symlink_to(device)
    (dev / "v4l" / "by-id").mkdir(parents=True)
    (dev / "video0").touch()
    (dev / "v4l" / "by-id" / "usb-Fake_camera-index0").symlink_to(dev / "video0")
    return sysfs, dev


def machine(dev: Path) -> Machine:
    streaming = v.CAP_STREAMING
    return Machine(
        dev,
        video0=v.CAP_VIDEO_CAPTURE | streaming,
        video1=streaming,
        video2=v.CAP_VIDEO_CAPTURE_MPLANE | streaming,
    )


def test_cameras_are_listed_with_what_they_offer(system: tuple[Path, Path]) -> None:
    sysfs, dev = system
    kernel = machine(dev)
    found = discover(kernel=kernel, sysfs=sysfs, dev=dev)
    assert [Path(camera.node).name for camera in found] == ["video0", "video2", "video10"], "a metadata file is none"
    usable, planar, dead = found
    assert usable.path == str(dev / "v4l" / "by-id" / "usb-Fake_camera-index0")
    assert (usable.card, usable.driver, usable.bus, usable.serial) == ("Fake camera", "fake", "bus-7", "SN-0042")
    assert [str(form) for form in usable.formats] == ["YUYV 640x480, 32x16", "GREY 32x16"]
    assert not usable.problem and "multi-planar" in planar.problem
    assert "there is no" in dead.problem and dead.card == "the video10"
    assert not kernel.fds


def test_no_video_devices_are_an_empty_list(tmp_path: Path) -> None:
    assert discover(kernel=FakeKernel(), sysfs=tmp_path / "none", dev=tmp_path) == []


def test_a_device_is_meant_by_path_serial_or_bus(system: tuple[Path, Path]) -> None:
    sysfs, dev = system
    kernel = machine(dev)
    node = str(dev / "video0")
    assert resolve("/dev/anything", "camera left", kernel=kernel, sysfs=sysfs, dev=dev) == "/dev/anything"
    assert resolve("SN-0042", "camera left", kernel=kernel, sysfs=sysfs, dev=dev) == node
    with pytest.raises(DeviceLost, match="SN-0042"):
        resolve("SN-1", "camera left", kernel=kernel, sysfs=sysfs, dev=dev)
    with pytest.raises(DriverError, match="2 cameras match 'bus-7'"):
        resolve("bus-7", "camera left", kernel=kernel, sysfs=sysfs, dev=dev)


def test_serial_numbers_are_those_of_the_usb_device(system: tuple[Path, Path]) -> None:
    sysfs, dev = system
    assert serial_of(str(dev / "v4l" / "by-id" / "usb-Fake_camera-index0"), sysfs=sysfs) == "SN-0042"
    assert serial_of("/dev/video10", sysfs=sysfs) == ""
