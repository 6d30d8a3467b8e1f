"""V4L2 cameras: those that are there, and whether rig.yaml's two are among them and can do what it wants."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from drivers.protocols import Side
from drivers.v4l2 import CameraFound, discover

area = Area("v4l2")

_LIST = "compare with: fringed devices"


def check(subject: Subject) -> Iterator[Finding]:
    """Every device, then left and right."""
    seen = discover(sysfs=subject.machine.path("/sys/class/video4linux"), dev=subject.machine.path("/dev"))
    if not subject.uses("v4l2"):
        for camera in seen:
            yield area.note("seen", f"{told(camera)}{f': {camera.problem}' if camera.problem else ''}")
        if not seen:
            yield area.note("seen", "no V4L2 camera is there")
        return
    matched: dict[Side, str] = {}
    for side, options in subject.cameras.items():
        yield from matching(side, options, seen, matched)
    if len(set(matched.values())) < len(matched):
        remedy = "give cameras.left.device and cameras.right.device two devices"
        yield area.problem("pair", f"left and right are the same camera, {matched['left']}", remedy)


def matching(side: Side, options: Any, seen: list[CameraFound], matched: dict[Side, str]) -> Iterator[Finding]:
    """One camera of the rig."""
    name, where = f"camera {side}", f"cameras.{side}"
    found = [camera for camera in seen if meant(camera, options.device)]
    if len(found) != 1:
        there = "; ".join(told(camera) for camera in found or seen) or "none is there"
        what = "is not there" if not found else f"fits {len(found)} cameras"
        remedy = f"plug it in, or correct {where}.device; {_LIST}"
        yield area.problem(name, f"{name} ({options.device}) {what}; {there}", remedy)
        return
    camera = found[0]
    matched[side] = camera.node
    if camera.problem:
        remedy = "end the program that holds it, or join its group: sudo usermod -aG video $USER"
        yield area.problem(name, f"{side}: {told(camera)}: {camera.problem}", remedy)
        return
    formats = {offer.fourcc: offer for offer in camera.formats}
    if options.format is not None and options.format not in formats:
        text = f"{side}: {camera.node} does not offer {options.format}, but {', '.join(formats) or 'nothing'}"
        yield area.problem(name, text, f"correct {where}.format")
        return
    offers = [formats[options.format]] if options.format is not None else list(formats.values())
    if options.size is not None and offers and not any(offered(offer, options.size) for offer in offers):
        text = f"{side}: {camera.node} does not offer {options.size[0]}x{options.size[1]}"
        yield area.problem(name, text, f"correct {where}.size; it offers {'; '.join(map(str, offers))}")
        return
    yield area.ok(name, f"{side}: {told(camera)}")


def meant(camera: CameraFound, device: str) -> bool:
    """Whether an option means this camera: by its path, or by serial or bus."""
    if device.startswith("/"):
        return Path(device).resolve() == Path(camera.node).resolve()
    return device in (camera.serial, camera.bus)


def offered(offer: Any, size: tuple[int, int]) -> bool:
    """Whether a format comes in a size."""
    if not offer.stepwise or len(offer.sizes) < 2:
        return not offer.sizes or tuple(size) in offer.sizes
    (least_width, least_height), (most_width, most_height) = offer.sizes[0], offer.sizes[-1]
    return bool(least_width <= size[0] <= most_width and least_height <= size[1] <= most_height)


def told(camera: CameraFound) -> str:
    """A camera in one line."""
    parts = [camera.card or "camera", f"serial {camera.serial}" if camera.serial else "no serial", camera.node]
    return ", ".join([*parts, *([camera.driver] if camera.driver else [])])
