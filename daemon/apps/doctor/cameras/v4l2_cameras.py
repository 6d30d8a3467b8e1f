"""V4L2 cameras: the connected ones, and rig.yaml's two among them with their formats and sizes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from drivers.protocols import Side
from drivers.v4l2 import DetectedCamera, discover
from drivers.v4l2.device import SupportedFormat
from drivers.v4l2.options import Options

area = Area("v4l2")

_LIST = "compare with: fringed devices"


def check(subject: Subject) -> Iterator[Finding]:
    """Check every device, then the left and the right camera."""
    connected = discover(sysfs=subject.machine.path("/sys/class/video4linux"), dev=subject.machine.path("/dev"))
    if not subject.uses("v4l2"):
        for camera in connected:
            yield area.note("seen", f"{describe(camera)}{f': {camera.problem}' if camera.problem else ''}")
        if not connected:
            yield area.note("seen", "no V4L2 camera is connected")
        return
    matched: dict[Side, str] = {}
    for side, options in subject.cameras.items():
        if isinstance(options, Options):
            yield from camera_findings(side, options, connected, matched)
    if len(set(matched.values())) < len(matched):
        remedy = "give cameras.left.device and cameras.right.device two devices"
        yield area.problem("pair", f"left and right are the same camera, {matched['left']}", remedy)


def camera_findings(
    side: Side, options: Options, connected: list[DetectedCamera], matched: dict[Side, str]
) -> Iterator[Finding]:
    """Check one camera of the rig; the selected camera is added to ``matched``."""
    name, key = f"camera {side}", f"cameras.{side}"
    selected = [camera for camera in connected if is_selected(camera, options.device)]
    if len(selected) != 1:
        candidates = "; ".join(describe(camera) for camera in selected or connected) or "no camera is connected"
        state = "is not connected" if not selected else f"selects {len(selected)} cameras"
        remedy = f"connect it, or correct {key}.device; {_LIST}"
        yield area.problem(name, f"{name} ({options.device}) {state}; {candidates}", remedy)
        return
    camera = selected[0]
    matched[side] = camera.node
    if camera.problem:
        remedy = "end the program that uses it, or join its group: sudo usermod -aG video $USER"
        yield area.problem(name, f"{side}: {describe(camera)}: {camera.problem}", remedy)
        return
    formats = {offer.fourcc: offer for offer in camera.formats}
    if options.format is not None and options.format not in formats:
        text = f"{side}: {camera.node} does not offer {options.format}; it offers {', '.join(formats) or 'no format'}"
        yield area.problem(name, text, f"correct {key}.format")
        return
    offers = [formats[options.format]] if options.format is not None else list(formats.values())
    if options.size is not None and offers and not any(supports_size(offer, options.size) for offer in offers):
        text = f"{side}: {camera.node} does not offer {options.size[0]}x{options.size[1]}"
        yield area.problem(name, text, f"correct {key}.size; it offers {'; '.join(map(str, offers))}")
        return
    yield area.ok(name, f"{side}: {describe(camera)}")


def is_selected(camera: DetectedCamera, device: str) -> bool:
    """Whether the option ``device`` selects a camera, by path, serial number or bus."""
    if device.startswith("/"):
        return Path(device).resolve() == Path(camera.node).resolve()
    return device in (camera.serial, camera.bus)


def supports_size(offer: SupportedFormat, size: tuple[int, int]) -> bool:
    """Whether a format is available in a size."""
    if not offer.stepwise or len(offer.sizes) < 2:
        return not offer.sizes or tuple(size) in offer.sizes
    (least_width, least_height), (most_width, most_height) = offer.sizes[0], offer.sizes[-1]
    return bool(least_width <= size[0] <= most_width and least_height <= size[1] <= most_height)


def describe(camera: DetectedCamera) -> str:
    """Format a camera as one line."""
    parts = [camera.card or "camera", f"serial {camera.serial}" if camera.serial else "no serial", camera.node]
    return ", ".join([*parts, *([camera.driver] if camera.driver else [])])
