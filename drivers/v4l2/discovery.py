"""Which cameras are there, and the device file that an option means."""

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
        path: the lasting one under /dev/v4l/by-id where there is one; node: /dev/videoN.
        card, driver, bus: as the kernel names it; serial: of the USB device, empty if it has none.
        formats: what it offers; problem: why it cannot be used, empty if it can.
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
    """Every device that gives images, also those that cannot be used now, with the reason."""
    kernel = kernel or LinuxKernel()
    nodes = sorted(sysfs.glob("video*"), key=lambda entry: (len(entry.name), entry.name)) if sysfs.is_dir() else []
    found = [_look(kernel, entry, dev) for entry in nodes]
    return [camera for camera in found if camera is not None]


def resolve(wanted: str, name: str, *, kernel: Kernel, sysfs: Path = SYSFS, dev: Path = DEV) -> str:
    """The device file of a path, a serial number or a bus.

    Raises:
        DeviceLost: none is there; DriverError: several are meant. Both list what is there.
    """
    if wanted.startswith("/"):
        return wanted
    there = discover(kernel=kernel, sysfs=sysfs, dev=dev)
    hits = [camera for camera in there if wanted in (camera.serial, camera.bus)]
    if len(hits) == 1:
        return hits[0].node
    listed = "; ".join(f"{c.node} {c.card} (serial {c.serial or 'unknown'}, bus {c.bus})" for c in hits or there)
    if hits:
        raise DriverError(f"{name}: {len(hits)} cameras are called {wanted!r}: {listed}; name one by its path")
    raise DeviceLost(f"{name}: no camera has the serial number or bus {wanted!r}; there are: {listed or 'none'}")


def serial_of(node: str, *, sysfs: Path = SYSFS) -> str:
    """The serial number of the device behind a file such as /dev/video0 (links are followed), empty if it has none."""
    device = (sysfs / Path(node).resolve().name / "device").resolve()
    for place in (device, *list(device.parents)[:4]):
        try:
            return (place / "serial").read_text(errors="replace").strip()[:128]
        except OSError:
            continue
    return ""


def _look(kernel: Kernel, entry: Path, dev: Path) -> DetectedCamera | None:
    node = str(dev / entry.name)
    path, serial = _lasting(node, dev), serial_of(node, sysfs=entry.parent)
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
    except DriverError as error:  # unplugged while it was asked
        return DetectedCamera(path, node, device.card, device.driver, device.bus, serial, problem=str(error))
    finally:
        device.close()


def _problem(device: Device) -> str | None:
    """Empty for a camera, a reason for one that cannot be read, None for what is no camera at all."""
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


def _lasting(node: str, dev: Path) -> str:
    """The path that stays the same when cameras are plugged in another order, if the system makes one."""
    for folder in ("by-id", "by-path"):
        links = sorted((dev / "v4l" / folder).glob("*")) if (dev / "v4l" / folder).is_dir() else []
        for link in links:
            if link.resolve() == Path(node).resolve():
                return str(link)
    return node
