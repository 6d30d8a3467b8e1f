"""GenICam cameras: the connected ones, and rig.yaml's two among them."""

from __future__ import annotations

from collections.abc import Iterator

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from drivers.genicam import DetectedCamera
from drivers.genicam.options import Options
from drivers.protocols import Side

area = Area("cameras")

_LIST = "compare with: fringed devices"


def check(subject: Subject) -> Iterator[Finding]:
    """Check every producer, then the left and the right camera."""
    for path, cameras in subject.cameras_by_producer.items():
        if isinstance(cameras, str):
            remedy = f"try the vendor's viewer; if that fails too, reinstall the producer {path}"
            yield area.graded("look", f"{path.name}: {cameras}", remedy, certain=subject.uses("genicam"))
    connected = subject.genicam
    if not subject.uses("genicam"):
        for camera in connected:
            yield area.ok("seen", describe(camera))
        if not connected:
            yield area.note("seen", "no GenICam camera is connected")
        return
    matched: dict[Side, DetectedCamera] = {}
    for side, options in subject.cameras.items():
        if isinstance(options, Options):
            yield from camera_findings(side, options, connected, matched)
    yield from pair(matched)
    for camera in connected:
        if camera not in matched.values():
            yield area.note("other", f"not in rig.yaml: {describe(camera)}")


def fits(camera: DetectedCamera, options: Options) -> bool:
    """Whether the options select a camera."""
    pairs = (options.serial, camera.serial), (options.model, camera.model), (options.user_name, camera.user_name)
    return all(value is None or value == actual for value, actual in pairs)


def camera_findings(
    side: Side, options: Options, connected: list[DetectedCamera], matched: dict[Side, DetectedCamera]
) -> Iterator[Finding]:
    """Check one camera of the rig; the selected camera is added to ``matched``."""
    keys = {"serial": options.serial, "model": options.model, "user_name": options.user_name}
    selection = ", ".join(f"{key} {value}" for key, value in keys.items() if value is not None)
    selected = [camera for camera in connected if fits(camera, options)]
    name = f"camera {side}"
    if not selected:
        others = "; ".join(describe(camera) for camera in connected) or "no camera is connected"
        remedy = f"connect and power it, or correct cameras.{side}.serial; {_LIST}"
        yield area.problem(name, f"{name} ({selection}) is not connected; {others}", remedy)
    elif len(selected) > 1:
        serials = ", ".join(camera.serial or "?" for camera in selected)
        remedy = f"select it by cameras.{side}.serial; {_LIST}"
        yield area.problem(name, f"{name} ({selection}) selects {len(selected)} cameras: {serials}", remedy)
    else:
        matched[side] = selected[0]
        if selected[0].access in ("free", "unknown"):
            yield area.ok(name, f"{side}: {describe(selected[0])}")
        else:
            text = f"{side}: {describe(selected[0])}, but it is {selected[0].access}"
            yield area.warning(
                name, text, "end the program that uses it (vendor's viewer, or a daemon: fringed status)"
            )


def pair(matched: dict[Side, DetectedCamera]) -> Iterator[Finding]:
    """Check the combination of both cameras."""
    if len(matched) < 2:
        return
    left, right = matched["left"], matched["right"]
    if left == right:
        remedy = "give cameras.left.serial and cameras.right.serial the serials of two cameras"
        yield area.problem("pair", f"left and right are the same camera, {left.serial}", remedy)
    elif left.model != right.model:
        text = f"left is a {left.model}, right a {right.model}: their triggers and read-outs have different durations"
        yield area.warning("pair", text, "use two cameras of one model, or compare their exposure delays")
    elif left.version != right.version:
        text = f"left has firmware {left.version or 'unknown'}, right {right.version or 'unknown'}"
        yield area.warning("firmware", text, "bring both to the same firmware with the vendor's tool")


def describe(camera: DetectedCamera) -> str:
    """Format a camera as one line."""
    parts = [" ".join(part for part in (camera.vendor, camera.model) if part) or "camera", camera.serial or "no serial"]
    parts += [f'"{camera.user_name}"'] if camera.user_name else []
    parts += [f"firmware {camera.version}"] if camera.version else []
    parts += [camera.transport] if camera.transport else []
    return ", ".join(parts)
