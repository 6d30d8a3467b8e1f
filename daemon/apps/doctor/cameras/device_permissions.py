"""Permissions of this user for the device files: groups, and udev rules for USB3 Vision cameras."""

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
    """Check the device files of V4L2 cameras, USB3 Vision cameras and graphics cards that the rig needs."""
    general = subject.config is None
    checked = 0
    for driver, pattern in (("v4l2", "/dev/video[0-9]*"), ("x11", "/dev/dri/renderD*")):
        if general or subject.uses(driver):
            nodes = subject.machine.entries(pattern)
            checked += len(nodes)
            yield from inaccessible(subject, nodes, certain=subject.uses(driver) and driver == "v4l2")
    if general or subject.uses("genicam"):
        devices = usb.devices(subject)
        checked += len(devices)
        for device in devices:
            yield from usb_camera(subject, device)
    user = "root" if os.geteuid() == 0 else pwd.getpwuid(os.geteuid()).pw_name
    if checked:
        yield area.ok("user", f"user {user}: {checked} device files checked")
    else:
        yield area.note("user", f"user {user}: no device files of cameras or graphics cards")


def inaccessible(subject: Subject, nodes: list[Path], *, certain: bool) -> Iterator[Finding]:
    """Device files without access for this user, one finding for each group."""
    groups: dict[str, list[str]] = {}
    for node in nodes:
        if not subject.machine.may_use(node):
            groups.setdefault(owner(node), []).append(f"/{node.relative_to(subject.machine.root)}")
    for group, names in groups.items():
        text = f"no access to {', '.join(names)}, which belong{'s' if len(names) == 1 else ''} to group {group}"
        remedy = f"sudo usermod -aG {group} $USER, then log in again"
        if group in pending_groups(subject):
            text, remedy = f"{text}; the membership is newer than this login", "log in again, or restart the service"
        yield area.graded(group, text, remedy, certain=certain)


def owner(node: Path) -> str:
    """The name of a file's group."""
    gid = node.stat().st_gid
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def pending_groups(subject: Subject) -> set[str]:
    """Groups of the user in /etc/group that this process lacks."""
    user, active = pwd.getpwuid(os.geteuid()).pw_name, set(os.getgroups())
    groups = set()
    for line in subject.machine.text("/etc/group").splitlines():
        name, _, number, members = [*line.split(":"), "", "", "", ""][:4]
        if user in members.split(",") and number.isdigit() and int(number) not in active:
            groups.add(name)
    return groups


def usb_camera(subject: Subject, device: Path) -> Iterator[Finding]:
    """Check a USB3 Vision camera's device file, and search for a udev rule of its vendor."""
    machine = subject.machine
    numbers = machine.number(device / "busnum"), machine.number(device / "devnum")
    vendor, name = machine.text(device / "idVendor"), machine.text(device / "product") or device.name
    if None in numbers:
        return
    node = f"/dev/bus/usb/{numbers[0]:03d}/{numbers[1]:03d}"
    if machine.path(node).exists() and machine.may_use(machine.path(node)):
        return
    rules = [rule for directory in RULES for rule in machine.entries(f"{directory}/*.rules")]
    has_rule = bool(vendor) and any(vendor in machine.text(rule) for rule in rules)
    if has_rule:
        remedy = (
            "sudo udevadm control --reload && sudo udevadm trigger; sudo usermod -aG plugdev $USER, then log in again"
        )
    else:
        rule = f'SUBSYSTEM=="usb", ATTRS{{idVendor}}=="{vendor}", MODE="0660", GROUP="plugdev"'
        remedy = f"add this line to /etc/udev/rules.d/70-cameras.rules and reconnect the camera: {rule}"
    text = f"no access to {name} ({node}); {'a' if has_rule else 'no'} udev rule for vendor {vendor} exists"
    yield area.graded("udev", text, remedy, certain=subject.uses("genicam"))
