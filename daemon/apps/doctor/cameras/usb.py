"""USB3 Vision cameras: the kernel's memory limit for transfers, and the speed of their ports."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import data_rate
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject

area = Area("usb")

MEMORY = "/sys/module/usbcore/parameters/usbfs_memory_mb"
_RECOMMENDED_MB = 1000
_SUPER_SPEED = 5000


def check(subject: Subject) -> Iterator[Finding]:
    """Check the memory limit, then every USB3 Vision camera on the bus."""
    cameras = devices(subject)
    used = data_rate.transport_used(subject, "U3V")
    if not cameras and used is False:
        yield area.note("cameras", "no USB3 Vision camera is connected")
        return
    yield memory(subject, certain=bool(cameras) or used is True or subject.uses("genicam"))
    for device in cameras:
        speed = subject.machine.number(device / "speed")
        name = subject.machine.text(device / "product") or device.name
        if speed is not None and speed < _SUPER_SPEED:
            text = f"{name} runs at {speed} Mbit/s, USB3 Vision needs {_SUPER_SPEED}"
            yield area.warning("speed", text, "use a USB 3 port of the PC itself and a USB 3 cable")
        elif speed is not None:
            yield area.ok("speed", f"{name} runs at {speed} Mbit/s")


def devices(subject: Subject) -> list[Path]:
    """The directories of USB3 Vision devices (class EF, subclass 05) below /sys/bus/usb/devices."""
    directories: dict[Path, None] = {}
    for interface in subject.machine.entries("/sys/bus/usb/devices/*:*"):
        kind = [subject.machine.text(interface / f"bInterface{part}").lower() for part in ("Class", "SubClass")]
        if kind == ["ef", "05"]:
            directories[interface.parent / interface.name.partition(":")[0]] = None
    return list(directories)


def memory(subject: Subject, *, certain: bool) -> Finding:
    """Compare the kernel's memory limit for USB transfers with the buffers of both cameras."""
    limit = subject.machine.number(MEMORY)
    if limit is None:
        return area.note("memory", "the kernel reports no memory limit for USB transfers (no USB host?)")
    frames, buffers = data_rate.frame_bytes(subject), [camera.buffers for camera in subject.cameras.values()]
    need = sum(size * count for size, count in zip(frames, buffers, strict=False)) / 1e6
    if limit == 0 or limit >= max(need, 1 if need else _RECOMMENDED_MB):
        return area.ok("memory", f"usbfs_memory_mb is {limit or 'unlimited'}")
    recommended = max(_RECOMMENDED_MB, round(need * 1.25))
    use = f"the buffers of both cameras take {need:.0f}" if need else f"two cameras need about {_RECOMMENDED_MB}"
    remedy = f"echo {recommended} | sudo tee {MEMORY}; permanently: kernel option usbcore.usbfs_memory_mb={recommended}"
    text = f"usbfs_memory_mb is {limit}, {use}: USB3 Vision cameras would lose frames"
    return area.warning("memory", text, remedy) if certain else area.note("memory", text, remedy)
