"""The cameras of this machine, and the device file of an option."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from drivers.errors import DeviceLost, DriverError
from drivers.v4l2.device import Device, SupportedFormat
from drivers.v4l2.kernel import Kernel, LinuxKernel

SYSFS = Path("/sys/class/video4linux")
DEV = Path("/dev")


@dataclass(frozen=True, slots=True)
class DetectedCamera:
    """A capture device of this machine.

    Args:
        path: the persistent one under /dev/v4l/by-id where there is one; node: /dev/videoN.
        card, driver, bus: from the kernel; serial: of the USB device, empty if it has none.
        formats: supported; problem: why it cannot be used, empty if it can.
    """

    path: str
    node: str
    card: str = ""
    driver: str = ""
    bus: str = ""
    serial: str = ""
    formats: tuple[SupportedFormat, ...] = field(default=())
    problem: str = ""


def discover(*, kernel: Kernel | None = None, sysfs: Path = SYSFS, dev: Path = DEV) -> list[DetectedCamera]:
    """List every device that captures images; those that cannot be used now have the reason."""
    kernel = kernel or LinuxKernel()
    nodes = sorted(sysfs.glob("video*"), key=lambda entry: (len(entry.name), entry.name)) if sysfs.is_dir() else []
    cameras = [_inspect(kernel, entry, dev) for entry in nodes]
    return [camera for camera in cameras if camera is not None]


def resolve(identifier: str, name: str, *, kernel: Kernel, sysfs: Path = SYSFS, dev: Path = DEV) -> str:
    """Return the device file of a path, a serial number or a bus.

    Raises:
        DeviceLost: no camera matches; DriverError: several do. Both list the cameras.
    """
    if identifier.startswith("/"):
        return identifier
    cameras = discover(kernel=kernel, sysfs=sysfs, dev=dev)
    matches = [camera for camera in cameras if identifier in (camera.serial, camera.bus)]
    if len(matches) == 1:
        return matches[0].node
    listed = "; ".join(f"{c.node} {c.card} (serial {c.serial or 'unknown'}, bus {c.bus})" for c in matches or cameras)
    if matches:
        raise DriverError(f"{name}: {len(matches)} cameras match {identifier!r}: {listed}; name one by its path")
    raise DeviceLost(f"{name}: no camera has the serial number or bus {identifier!r}; there are: {listed or 'none'}")


def serial_of(node: str, *, sysfs: Path = SYSFS) -> str:
    """Return the serial number of the device of a file such as /dev/video0 (links are followed), empty without one."""
    device = (sysfs / Path(node).resolve().name / "device").resolve()
    for directory in (device, *list(device.parents)[:4]):
        try:
            return (directory / "serial").read_text(errors="replace").strip()[:128]
        except OSError:
            continue
    return ""


def _inspect(kernel: Kernel, entry: Path, dev: Path) -> DetectedCamera | None:
    node = str(dev / entry.name)
    path, serial = _persistent_path(node, dev), serial_of(node, sysfs=entry.parent)
    try:
        device = Device(kernel, node, f"camera {node}")
    except DriverError as error:
        return DetectedCamera(path, node, card=_card(entry), serial=serial, problem=str(error))
    try:
        problem = _problem(device)
        if problem is None:
            return None
        offered = () if problem else device.formats()
        return DetectedCamera(path, node, device.card, device.driver, device.bus, serial, offered, problem)
    except DriverError as error:  # unplugged during the inspection
        return DetectedCamera(path, node, device.card, device.driver, device.bus, serial, problem=str(error))
    finally:
        device.close()


def _problem(device: Device) -> str | None:
    """Return an empty text for a camera, a reason for an unsupported one, None for another device."""
    try:
        device.check_capture()
    except DriverError as error:
        return str(error) if "multi-planar" in str(error) else None
    return ""


def _card(entry: Path) -> str:
    try:
        return (entry / "name").read_text(errors="replace").strip()
    except OSError:
        return ""


def _persistent_path(node: str, dev: Path) -> str:
    """Return the path that is independent of the order of plugging in, if the system has one."""
    for folder in ("by-id", "by-path"):
        links = sorted((dev / "v4l" / folder).glob("*")) if (dev / "v4l" / folder).is_dir() else []
        for link in links:
            if link.resolve() == Path(node).resolve():
                return str(link)
    return node
