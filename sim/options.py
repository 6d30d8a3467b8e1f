"""The ``sim`` options of a rig: plain values in, checked objects out."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

from drivers.protocols import Side
from sim.faults import RANDOM_KINDS, Fault, FaultKind, FaultPlan
from sim.optics import Optics
from sim.rig import RigLayout
from sim.scenes import NAMES
from sim.sensor import ENCODINGS


class OptionError(ValueError):
    """An option of the simulated rig that is not known or not possible; the message names it."""


@dataclass(frozen=True, slots=True)
class SimOptions:
    """Everything a simulated rig is made of.

    Args:
        scene: name, see :mod:`sim.scenes`.
        mesh: file of a triangle mesh, for the scene ``mesh``.
        seed: of textures and noise.
        frames: pictures in the loop.
        layout: the rig.
        optics: light, lenses, sensors.
        encoding: what the cameras send.
        faults: what goes wrong.
        rate_hz: triggers a second; 0 = only by ``trigger.step()``.
        cache_dir: where rendered loops are kept; None = the user's cache directory.
    """

    scene: str = "moving"
    mesh: Path | None = None
    seed: int = 0
    frames: int = 24
    layout: RigLayout = field(default_factory=RigLayout)
    optics: Optics = field(default_factory=Optics)
    encoding: str = "rgb8"
    faults: FaultPlan = field(default_factory=FaultPlan)
    rate_hz: float = 10.0
    cache_dir: Path | None = None

    def __post_init__(self) -> None:
        _one_of("scene", self.scene, NAMES)
        _one_of("encoding", self.encoding, ENCODINGS)
        if not 1 <= self.frames <= 1000:
            raise OptionError(f"sim.frames is {self.frames}, expected 1 to 1000")
        if not 0 <= self.rate_hz <= 1000:
            raise OptionError(f"sim.rate_hz is {self.rate_hz}, expected 0 (stepped) to 1000")
        if self.seed < 0:
            raise OptionError(f"sim.seed is {self.seed}, expected 0 or more")
        if self.scene == "mesh" and (self.mesh is None or not self.mesh.is_file()):
            raise OptionError(f"sim.mesh is {self.mesh}: scene 'mesh' needs an OBJ, PLY or STL file that exists")


def from_mapping(data: Mapping[str, Any], base_dir: Path | None = None) -> SimOptions:
    """Options of plain values; relative paths start at ``base_dir``. Errors name the key."""
    known("sim", data, [item.name for item in fields(SimOptions)])
    values: dict[str, Any] = {key: value for key, value in data.items() if value is not None}
    for key, kind in (("scene", str), ("encoding", str), ("seed", int), ("frames", int)):
        if key in values and (not isinstance(values[key], kind) or isinstance(values[key], bool)):
            raise OptionError(f"sim.{key} is {values[key]!r}, expected {kind.__name__}")
    for key in ("mesh", "cache_dir"):
        if key in values:
            values[key] = (base_dir or Path()) / Path(values[key]).expanduser()
    if "layout" in values:
        values["layout"] = _layout(values["layout"])
    if "optics" in values:
        values["optics"] = _optics(values["optics"])
    if "faults" in values:
        values["faults"] = _faults(values["faults"], int(values.get("seed", 0)))
    return _made("sim", SimOptions, values)


def _layout(data: Mapping[str, Any]) -> RigLayout:
    known("sim.layout", data, [*(item.name for item in fields(RigLayout)), "scale"])
    values = {key: tuple(v) if isinstance(v, list) else v for key, v in data.items() if key != "scale"}
    layout: RigLayout = _made("sim.layout", RigLayout, values)
    scale = data.get("scale", 1.0)
    if not isinstance(scale, int | float) or not 0 < scale <= 4:
        raise OptionError(f"sim.layout.scale is {scale!r}, expected more than 0, at most 4")
    return layout if scale == 1 else layout.scaled(float(scale))


def _optics(data: Mapping[str, Any]) -> Optics:
    known("sim.optics", data, [*(item.name for item in fields(Optics)), "preset"])
    values = {key: tuple(v) if isinstance(v, list) else v for key, v in data.items() if key != "preset"}
    presets = {"standard": Optics, "realistic": Optics.realistic, "ideal": Optics.ideal}
    preset = data.get("preset", "standard")
    _one_of("optics.preset", preset, tuple(presets))
    optics: Optics = _made("sim.optics", presets[preset], values)
    return optics


def _faults(data: Mapping[str, Any], seed: int) -> FaultPlan:
    """Rates by kind, ``extra_first: left|right``, ``seed``, and ``script``: a list of {kind, at, side, length}."""
    known("sim.faults", data, [*RANDOM_KINDS, "extra_first", "seed", "script"])
    script = [_fault(i, item) for i, item in enumerate(data.get("script", ()))]
    extra = data.get("extra_first")
    if extra:
        _one_of("faults.extra_first", extra, get_args(Side))
        script.append(Fault(FaultKind.EXTRA_FIRST, 0, extra))
    rates = {kind: data[kind] for kind in RANDOM_KINDS if kind in data}
    plan: FaultPlan = _made(
        "sim.faults", FaultPlan, {"scripted": tuple(script), "rates": rates, "seed": data.get("seed", seed)}
    )
    return plan


def _fault(i: int, data: Mapping[str, Any]) -> Fault:
    name = f"faults.script[{i}]"
    known(f"sim.{name}", data, [item.name for item in fields(Fault)])
    _one_of(f"{name}.kind", data.get("kind"), tuple(FaultKind))
    fault: Fault = _made(f"sim.{name}", Fault, {"at": 0, **data, "kind": FaultKind(data["kind"])})
    if fault.side is not None:
        _one_of(f"{name}.side", fault.side, get_args(Side))
    return replace(fault, at=int(fault.at), length=int(fault.length))


def known(name: str, data: object, keys: list[str]) -> None:
    """OptionError unless ``data`` is a mapping with some of these keys; ``name`` stands for it in the message."""
    if not isinstance(data, Mapping):
        raise OptionError(f"{name} is {data!r:.60}, expected a mapping")
    for key in data:
        if key not in keys:
            near = difflib.get_close_matches(str(key), keys, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; there are {', '.join(keys)}"
            raise OptionError(f"{name}.{key} is not an option{hint}")


def _one_of(name: str, value: object, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise OptionError(f"sim.{name} is {value!r}, expected one of {', '.join(allowed)}")


def _made(name: str, make: Any, values: dict[str, Any]) -> Any:
    """The object, with every complaint about its values told as one about the option."""
    try:
        return make(**values)
    except OptionError:
        raise
    except (TypeError, ValueError) as error:
        raise OptionError(f"{name}: {error}") from error
