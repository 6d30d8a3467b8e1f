"""GenICam cameras: those that are seen, and whether rig.yaml's two are among them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from drivers.genicam import CameraFound
from drivers.protocols import Side

area = Area("cameras")

_LIST = "compare with: fringed devices"


def check(subject: Subject) -> Iterator[Finding]:
    """Every camera of every producer, then left and right."""
    for path, cameras in subject.looked.items():
        if isinstance(cameras, str):
            remedy = f"try the vendor's own viewer; if that fails too, install the producer {path} anew"
            yield area.trouble("look", f"{path.name}: {cameras}", remedy, certain=subject.uses("genicam"))
    seen = subject.genicam
    if not subject.uses("genicam"):
        for camera in seen:
            yield area.ok("seen", told(camera))
        if not seen:
            yield area.note("seen", "no GenICam camera is seen")
        return
    matched: dict[Side, CameraFound] = {}
    for side, options in subject.cameras.items():
        yield from matching(side, options, [camera for camera in seen if fits(camera, options)], seen, matched)
    yield from pair(matched)
    for camera in seen:
        if camera not in matched.values():
            yield area.note("other", f"not in rig.yaml: {told(camera)}")


def fits(camera: CameraFound, options: Any) -> bool:
    """Whether a camera is one that the options mean."""
    wanted = (options.serial, camera.serial), (options.model, camera.model), (options.user_name, camera.user_name)
    return all(value is None or value == has for value, has in wanted)


def matching(
    side: Side, options: Any, found: list[CameraFound], seen: list[CameraFound], matched: dict[Side, CameraFound]
) -> Iterator[Finding]:
    """One camera of the rig; the camera that fits is put into ``matched``."""
    keys = ("serial", "model", "user_name")
    wanted = ", ".join(f"{key} {getattr(options, key)}" for key in keys if getattr(options, key) is not None)
    name = f"camera {side}"
    if not found:
        there = "; ".join(told(camera) for camera in seen) or "none is seen"
        remedy = f"plug it in and power it, or correct cameras.{side}.serial; {_LIST}"
        yield area.problem(name, f"{name} ({wanted}) is not there; {there}", remedy)
    elif len(found) > 1:
        serials = ", ".join(camera.serial or "?" for camera in found)
        remedy = f"name it by cameras.{side}.serial; {_LIST}"
        yield area.problem(name, f"{name} ({wanted}) fits {len(found)} cameras: {serials}", remedy)
    else:
        matched[side] = found[0]
        if found[0].access in ("free", "unknown"):
            yield area.ok(name, f"{side}: {told(found[0])}")
        else:
            text = f"{side}: {told(found[0])}, but it is {found[0].access}"
            yield area.warning(
                name, text, "end the program that holds it (vendor's viewer, or a daemon: fringed status)"
            )


def pair(matched: dict[Side, CameraFound]) -> Iterator[Finding]:
    """What the two of them make together."""
    if len(matched) < 2:
        return
    left, right = matched["left"], matched["right"]
    if left == right:
        remedy = "give cameras.left.serial and cameras.right.serial the serials of two cameras"
        yield area.problem("pair", f"left and right are the same camera, {left.serial}", remedy)
    elif left.model != right.model:
        text = f"left is a {left.model}, right a {right.model}: their triggers and read-outs take different times"
        yield area.warning("pair", text, "use two cameras of one model, or compare their exposure delays")
    elif left.version != right.version:
        text = f"left has firmware {left.version or 'unknown'}, right {right.version or 'unknown'}"
        yield area.warning("firmware", text, "bring both to the same firmware with the vendor's tool")


def told(camera: CameraFound) -> str:
    """A camera in one line."""
    parts = [" ".join(part for part in (camera.vendor, camera.model) if part) or "camera", camera.serial or "no serial"]
    parts += [f'"{camera.user_name}"'] if camera.user_name else []
    parts += [f"firmware {camera.version}"] if camera.version else []
    parts += [camera.transport] if camera.transport else []
    return ", ".join(parts)
