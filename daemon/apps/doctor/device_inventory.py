"""Every camera and projector output that can be seen, with what rig.yaml calls them by."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from drivers.errors import DriverError

Named = dict[str, Any]


class Inventory(msgspec.Struct):
    """What was found.

    Args:
        genicam, v4l2, outputs: each device with its keys; problems: what could not be looked at, and why.
    """

    genicam: list[Named] = []
    v4l2: list[Named] = []
    outputs: list[Named] = []
    problems: list[str] = []


def take(named: Sequence[Path] = (), display: str = "") -> Inventory:
    """Look for everything; what fails is told and the rest is looked at all the same.

    Args:
        named: GenTL producers; those of GENICAM_GENTL64_PATH if none is named. display: an X display.
    """
    found = Inventory()
    for producer in _producers(named, found.problems):
        found.genicam += _tried(f"producer {producer}", lambda p=producer: _genicam(p), found.problems)  # type: ignore[misc]
    found.v4l2 += _tried("V4L2", _v4l2, found.problems)
    found.outputs += _tried("outputs", lambda: _outputs(display), found.problems)
    return found


def _producers(named: Sequence[Path], problems: list[str]) -> list[Path]:
    from drivers.genicam.options import producers

    try:
        return producers([str(path) for path in named], Path.cwd())
    except (ValueError, OSError) as error:
        problems.append(f"GenICam: {error}")
        return []


def _tried(what: str, look: Callable[[], list[Named]], problems: list[str]) -> list[Named]:
    try:
        return look()
    except (DriverError, OSError) as error:
        problems.append(f"{what}: {error}")
        return []


def _genicam(producer: Path) -> list[Named]:
    from drivers.genicam import discover

    return [{**msgspec.structs.asdict(camera), "producer": str(producer)} for camera in discover([producer])]


def _v4l2() -> list[Named]:
    from drivers.v4l2 import discover

    return [{**asdict(camera), "device": camera.path} for camera in discover()]


def _outputs(display: str) -> list[Named]:
    from drivers.projector import outputs

    return [msgspec.structs.asdict(output) for output in outputs(display) if output.connected]


def lines(found: Inventory) -> Iterator[tuple[str, bool]]:
    """The printed lines, and whether each is a heading. The keys of rig.yaml stand as they are written there."""
    yield "GenICam cameras   cameras.driver: genicam", True
    for camera in found.genicam:
        title = " ".join(part for part in (camera["vendor"], camera["model"]) if part)
        yield _joined(title, f"firmware {camera['version'] or 'unknown'}", camera["transport"], camera["access"]), False
        yield from _keys(camera, "serial", "user_name", "model")
        yield f"      producer: {camera['producer']}", False
    yield from _nothing(found.genicam)
    yield "V4L2 cameras      cameras.driver: v4l2", True
    for camera in found.v4l2:
        yield _joined(camera["card"], camera["driver"], camera["bus"], camera["node"]), False
        yield from _keys(camera, "device")
        if camera["serial"]:
            yield f"      device: {camera['serial']}   (its serial number, the same)", False
        for offer in camera["formats"]:
            yield f"      format: {offer['fourcc']}   size: {_sizes(offer)}", False
        if camera["problem"]:
            yield f"      cannot be used: {camera['problem']}", False
    yield from _nothing(found.v4l2)
    yield "Projector outputs projector.driver: x11", True
    for output in found.outputs:
        yield from _output(output)
    yield from _nothing(found.outputs)


def _output(output: Named) -> Iterator[tuple[str, bool]]:
    native, size = output["preferred_size"], output["size"]
    words = [f"native {_pixels(native)}" if native else "native size unknown"]
    words += ["primary"] if output["primary"] else []
    words += ["switched off"] if not any(size) else []
    words += [f"rotated {output['rotation']}"] if output["rotation"] != "normal" else []
    words += ["scaled"] if output["scaled"] else []
    words += {True: ["gamma linear"], False: ["gamma NOT linear"], None: []}[output["gamma_identity"]]
    yield _joined(output["edid_name"] or "connected", *words), False
    rate = f"   refresh_hz: {output['refresh_hz']:.3f}" if output["refresh_hz"] else ""
    yield f"      output: {output['name']}   size: [{size[0]}, {size[1]}]{rate}", False


def _keys(device: Named, *names: str) -> Iterator[tuple[str, bool]]:
    told = [f"{name}: {_quoted(str(device[name]))}" for name in names if device[name]]
    yield f"      {'   '.join(told) or 'it tells nothing to name it by'}", False


def _quoted(text: str) -> str:
    """As YAML wants it: serial numbers of digits are texts."""
    plain = text.replace("-", "").replace("_", "").replace("/", "").replace(".", "").replace(":", "")
    return text if plain.isalnum() and not plain.isdigit() and not text[0].isdigit() else f'"{text}"'


def _nothing(devices: list[Named]) -> Iterator[tuple[str, bool]]:
    if not devices:
        yield "   none", False


def _joined(*parts: str) -> str:
    return "   " + ", ".join(part for part in parts if part)


def _pixels(size: Sequence[int]) -> str:
    return f"{size[0]}x{size[1]}"


def _sizes(offer: Named) -> str:
    shown = [f"[{width}, {height}]" for width, height in offer["sizes"][:8]]
    more = ", ..." if len(offer["sizes"]) > 8 else ""
    return (" to " if offer["stepwise"] else ", ").join(shown) + more
