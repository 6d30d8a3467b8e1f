"""The connected cameras and projector outputs, with their keys in rig.yaml."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from drivers.errors import DriverError

Device = dict[str, Any]


class Inventory(msgspec.Struct):
    """The connected devices.

    Args:
        genicam, v4l2, outputs: each device with its keys; problems: reasons for missing parts.
    """

    genicam: list[Device] = []
    v4l2: list[Device] = []
    outputs: list[Device] = []
    problems: list[str] = []


def inventory(producers: Sequence[Path] = (), display: str = "") -> Inventory:
    """List all devices; failures are reported and do not affect the other devices.

    Args:
        producers: GenTL producers; those of GENICAM_GENTL64_PATH if empty. display: an X display.
    """
    devices = Inventory()
    for producer in _producers(producers, devices.problems):
        devices.genicam += _discovered(f"producer {producer}", lambda p=producer: _genicam(p), devices.problems)  # type: ignore[misc]
    devices.v4l2 += _discovered("V4L2", _v4l2, devices.problems)
    devices.outputs += _discovered("outputs", lambda: _outputs(display), devices.problems)
    return devices


def _producers(paths: Sequence[Path], problems: list[str]) -> list[Path]:
    from drivers.genicam.options import producers

    try:
        return producers([str(path) for path in paths], Path.cwd())
    except (ValueError, OSError) as error:
        problems.append(f"GenICam: {error}")
        return []


def _discovered(source: str, discover: Callable[[], list[Device]], problems: list[str]) -> list[Device]:
    try:
        return discover()
    except (DriverError, OSError) as error:
        problems.append(f"{source}: {error}")
        return []


def _genicam(producer: Path) -> list[Device]:
    from drivers.genicam import discover

    return [{**msgspec.structs.asdict(camera), "producer": str(producer)} for camera in discover([producer])]


def _v4l2() -> list[Device]:
    from drivers.v4l2 import discover

    return [{**asdict(camera), "device": camera.path} for camera in discover()]


def _outputs(display: str) -> list[Device]:
    from drivers.projector import outputs

    return [msgspec.structs.asdict(output) for output in outputs(display) if output.connected]


def lines(devices: Inventory) -> Iterator[tuple[str, bool]]:
    """The printed lines, and whether each is a heading; keys are printed as rig.yaml expects them."""
    yield "GenICam cameras   cameras.driver: genicam", True
    for camera in devices.genicam:
        title = " ".join(part for part in (camera["vendor"], camera["model"]) if part)
        yield _joined(title, f"firmware {camera['version'] or 'unknown'}", camera["transport"], camera["access"]), False
        yield from _keys(camera, "serial", "user_name", "model")
        yield f"      producer: {camera['producer']}", False
    yield from _none(devices.genicam)
    yield "V4L2 cameras      cameras.driver: v4l2", True
    for camera in devices.v4l2:
        yield _joined(camera["card"], camera["driver"], camera["bus"], camera["node"]), False
        yield from _keys(camera, "device")
        if camera["serial"]:
            yield f"      device: {camera['serial']}   (serial number, equivalent)", False
        for offer in camera["formats"]:
            yield f"      format: {offer['fourcc']}   size: {_sizes(offer)}", False
        if camera["problem"]:
            yield f"      not usable: {camera['problem']}", False
    yield from _none(devices.v4l2)
    yield "Projector outputs projector.driver: x11", True
    for output in devices.outputs:
        yield from _output(output)
    yield from _none(devices.outputs)


def _output(output: Device) -> Iterator[tuple[str, bool]]:
    native, size = output["preferred_size"], output["size"]
    parts = [f"native {_pixels(native)}" if native else "native size unknown"]
    parts += ["primary"] if output["primary"] else []
    parts += ["switched off"] if not any(size) else []
    parts += [f"rotated {output['rotation']}"] if output["rotation"] != "normal" else []
    parts += ["scaled"] if output["scaled"] else []
    parts += {True: ["gamma linear"], False: ["gamma NOT linear"], None: []}[output["gamma_identity"]]
    yield _joined(output["edid_name"] or "connected", *parts), False
    rate = f"   refresh_hz: {output['refresh_hz']:.3f}" if output["refresh_hz"] else ""
    yield f"      output: {output['name']}   size: [{size[0]}, {size[1]}]{rate}", False


def _keys(device: Device, *names: str) -> Iterator[tuple[str, bool]]:
    keys = [f"{name}: {_quoted(str(device[name]))}" for name in names if device[name]]
    yield f"      {'   '.join(keys) or 'no serial number, name or model'}", False


def _quoted(text: str) -> str:
    """Quote a value for YAML where necessary, such as a serial number of digits."""
    plain = text.replace("-", "").replace("_", "").replace("/", "").replace(".", "").replace(":", "")
    return text if plain.isalnum() and not plain.isdigit() and not text[0].isdigit() else f'"{text}"'


def _none(group: list[Device]) -> Iterator[tuple[str, bool]]:
    if not group:
        yield "   none", False


def _joined(*parts: str) -> str:
    return "   " + ", ".join(part for part in parts if part)


def _pixels(size: Sequence[int]) -> str:
    return f"{size[0]}x{size[1]}"


def _sizes(offer: Device) -> str:
    sizes = [f"[{width}, {height}]" for width, height in offer["sizes"][:8]]
    more = ", ..." if len(offer["sizes"]) > 8 else ""
    return (" to " if offer["stepwise"] else ", ").join(sizes) + more
