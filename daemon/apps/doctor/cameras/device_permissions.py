"""Whether this user may use the device files: groups, and udev's rules for USB3 Vision cameras."""

from __future__ import annotations

import grp
import os
import pwd
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import usb
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject

area = Area("rights")

RULES = "etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d"


def check(subject: Subject) -> Iterator[Finding]:
    """Device files of V4L2 cameras, USB3 Vision cameras and graphics cards, as far as the rig needs them."""
    general = subject.config is None
    looked = 0
    for driver, pattern in (("v4l2", "/dev/video[0-9]*"), ("x11", "/dev/dri/renderD*")):
        if general or subject.uses(driver):
            nodes = subject.machine.entries(pattern)
            looked += len(nodes)
            yield from refused(subject, nodes, certain=subject.uses(driver) and driver == "v4l2")
    if general or subject.uses("genicam"):
        devices = usb.devices(subject)
        looked += len(devices)
        for device in devices:
            yield from usb_camera(subject, device)
    who = "root" if os.geteuid() == 0 else pwd.getpwuid(os.geteuid()).pw_name
    if looked:
        yield area.ok("user", f"looked as {who} at {looked} device files")
    else:
        yield area.note("user", f"no device files of cameras or graphics cards to look at (as {who})")


def refused(subject: Subject, nodes: list[Path], *, certain: bool) -> Iterator[Finding]:
    """Those that this user may not use, one finding a group."""
    groups: dict[str, list[str]] = {}
    for node in nodes:
        if not subject.machine.may_use(node):
            groups.setdefault(owner(node), []).append(f"/{node.relative_to(subject.machine.root)}")
    for group, names in groups.items():
        text = f"no access to {', '.join(names)}, which belong{'s' if len(names) == 1 else ''} to group {group}"
        remedy = f"sudo usermod -aG {group} $USER, then log in again"
        if group in waiting(subject):
            text, remedy = f"{text}; you are in it since you logged in", "log in again, or restart the service"
        yield area.trouble(group, text, remedy, certain=certain)


def owner(node: Path) -> str:
    """The name of a file's group."""
    gid = node.stat().st_gid
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def waiting(subject: Subject) -> set[str]:
    """Groups that the user is in by /etc/group and this process is not yet."""
    user, now = pwd.getpwuid(os.geteuid()).pw_name, set(os.getgroups())
    found = set()
    for line in subject.machine.text("/etc/group").splitlines():
        name, _, number, members = [*line.split(":"), "", "", "", ""][:4]
        if user in members.split(",") and number.isdigit() and int(number) not in now:
            found.add(name)
    return found


def usb_camera(subject: Subject, device: Path) -> Iterator[Finding]:
    """A USB3 Vision camera's device file, and whether a rule of udev speaks of its vendor."""
    machine = subject.machine
    numbers = machine.number(device / "busnum"), machine.number(device / "devnum")
    vendor, name = machine.text(device / "idVendor"), machine.text(device / "product") or device.name
    if None in numbers:
        return
    node = machine.path(f"/dev/bus/usb/{numbers[0]:03d}/{numbers[1]:03d}")
    if node.exists() and machine.may_use(node):
        return
    known = any(
        vendor and vendor in machine.text(rule) for place in RULES for rule in machine.entries(f"{place}/*.rules")
    )
    if known:
        remedy = (
            "sudo udevadm control --reload && sudo udevadm trigger; sudo usermod -aG plugdev $USER, then log in again"
        )
    else:
        rule = f'SUBSYSTEM=="usb", ATTRS{{idVendor}}=="{vendor}", MODE="0660", GROUP="plugdev"'
        remedy = f"put this line into /etc/udev/rules.d/70-cameras.rules and plug the camera in again: {rule}"
    text = (
        f"no access to {name} (/dev/bus/usb/{numbers[0]:03d}/{numbers[1]:03d}); {'a' if known else 'no'} rule of udev"
    )
    yield area.trouble("udev", f"{text} speaks of vendor {vendor}", remedy, certain=subject.uses("genicam"))
