"""The ``sim`` options of a rig: read from plain values and checked."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

from drivers.protocols import Side
from pipeline.calibrate.targets.board.board import parse_board
from pipeline.common.errors import TargetError
from sim.devices.faults import RANDOM_KINDS, Fault, FaultKind, FaultPlan
from sim.render.sensor import ENCODINGS
from sim.rig.disturbance import DEVICES, Disturbance
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import NAMES

BOARD_SCENE = "board"
_SCENES = (*NAMES, BOARD_SCENE)


class OptionError(ValueError):
    """An unknown or invalid option of the simulated rig; the message names it."""


@dataclass(frozen=True, slots=True)
class SimOptions:
    """Options of a simulated rig.

    Args:
        scene: name, see :mod:`sim.scene.named_scenes`, or ``board``.
        mesh: file of a triangle mesh, for the scene ``mesh``.
        seed: of textures and noise.
        frames: images in the loop.
        layout: the rig.
        optics: light, lenses, sensors.
        encoding: of the cameras.
        faults: of frames and cameras.
        rate_hz: triggers a second; 0 = only by ``trigger.step()``.
        cache_dir: of rendered loops; None = the user's cache directory.
        live: whether images are rendered on demand, of the image that the projector shows; else a loop is rendered
            beforehand and the projector shows only its pattern.
        board: of the scene ``board``, such as ``circles:11x9:32:20``; poses: number of its poses in a live rig.
        hold: triggers after which the board of a live rig moves on by itself; 0 = only by ``trigger.next_pose()``.
        disturb: disturbances of the rig by trigger; the calibration is that of the undisturbed rig.
        background: whether a loop that is not cached is shown from its first image on, while a process renders the
            others; which image a trigger shows then depends on the time.
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
    live: bool = False
    board: str = ""
    poses: int = 12
    hold: int = 0
    disturb: tuple[Disturbance, ...] = ()
    background: bool = False

    def __post_init__(self) -> None:
        _one_of("scene", self.scene, _SCENES)
        _one_of("encoding", self.encoding, ENCODINGS)
        if not 1 <= self.frames <= 1000:
            raise OptionError(f"sim.frames is {self.frames}, expected 1 to 1000")
        if not 0 <= self.rate_hz <= 1000:
            raise OptionError(f"sim.rate_hz is {self.rate_hz}, expected 0 (stepped) to 1000")
        if self.seed < 0:
            raise OptionError(f"sim.seed is {self.seed}, expected 0 or more")
        if self.scene == "mesh" and (self.mesh is None or not self.mesh.is_file()):
            raise OptionError(f"sim.mesh is {self.mesh}: scene 'mesh' needs an OBJ, PLY or STL file that exists")
        if self.background and (self.live or self.disturb or self.rate_hz == 0):
            raise OptionError(
                "sim.background is true: only a loop without disturbances that is triggered in real time can be "
                "rendered meanwhile; remove it, or sim.live, sim.disturb and sim.rate_hz: 0"
            )
        self._check_board()

    def _check_board(self) -> None:
        if self.board and self.scene != BOARD_SCENE:
            raise OptionError(f"sim.board is {self.board!r} and sim.scene {self.scene!r}: only scene 'board' has one")
        if self.hold and not (self.live and self.scene == BOARD_SCENE):
            raise OptionError(f"sim.hold is {self.hold}: only the board of a live rig moves; set sim.live: true")
        if not 1 <= self.poses <= 1000:
            raise OptionError(f"sim.poses is {self.poses}, expected 1 to 1000")
        if not 0 <= self.hold <= 1_000_000:
            raise OptionError(f"sim.hold is {self.hold}, expected 0 to 1000000 triggers")
        try:
            if self.board:
                parse_board(self.board)
        except TargetError as error:
            raise OptionError(f"sim.board: {error}") from error


_KINDS: dict[str, type] = {
    "scene": str, "encoding": str, "seed": int, "frames": int, "live": bool, "board": str, "poses": int, "hold": int,
    "background": bool,
}  # fmt: skip


def from_mapping(data: Mapping[str, Any], base_dir: Path | None = None) -> SimOptions:
    """Options of plain values; relative paths start at ``base_dir``. Errors name the key."""
    check_keys("sim", data, [item.name for item in fields(SimOptions)])
    values: dict[str, Any] = {key: value for key, value in data.items() if value is not None}
    for key, kind in _KINDS.items():
        if key in values and (not isinstance(values[key], kind) or isinstance(values[key], bool) != (kind is bool)):
            raise OptionError(f"sim.{key} is {values[key]!r}, expected {kind.__name__}")
    rate_hz = values.get("rate_hz", 0.0)
    if not isinstance(rate_hz, int | float) or isinstance(rate_hz, bool):
        raise OptionError(f"sim.rate_hz is {rate_hz!r}, expected a number")
    for key in ("mesh", "cache_dir"):
        if key in values and not isinstance(values[key], str | Path):
            raise OptionError(f"sim.{key} is {values[key]!r}, expected a path")
        if key in values:
            values[key] = (base_dir or Path()) / Path(values[key]).expanduser()
    if "layout" in values:
        values["layout"] = _layout(values["layout"])
    if "optics" in values:
        values["optics"] = _optics(values["optics"])
    if "disturb" in values:
        values["disturb"] = _disturbances(values["disturb"])
    if "faults" in values:
        values["faults"] = _faults(values["faults"], int(values.get("seed", 0)))
    return _built("sim", SimOptions, values)


def _layout(data: Mapping[str, Any]) -> RigLayout:
    check_keys("sim.layout", data, [*(item.name for item in fields(RigLayout)), "scale"])
    values = {key: tuple(v) if isinstance(v, list) else v for key, v in data.items() if key != "scale"}
    layout: RigLayout = _built("sim.layout", RigLayout, values)
    scale = data.get("scale", 1.0)
    if not isinstance(scale, int | float) or not 0 < scale <= 4:
        raise OptionError(f"sim.layout.scale is {scale!r}, expected more than 0, at most 4")
    return layout if scale == 1 else layout.scaled(float(scale))


def _optics(data: Mapping[str, Any]) -> Optics:
    check_keys("sim.optics", data, [*(item.name for item in fields(Optics)), "preset"])
    values = {key: tuple(v) if isinstance(v, list) else v for key, v in data.items() if key != "preset"}
    presets = {"standard": Optics, "realistic": Optics.realistic, "ideal": Optics.ideal}
    preset = data.get("preset", "standard")
    _one_of("optics.preset", preset, tuple(presets))
    optics: Optics = _built("sim.optics", presets[preset], values)
    return optics


def _disturbances(data: object) -> tuple[Disturbance, ...]:
    """A list of {at, side, turn_deg, shift_px, crosstalk}, in the order of their triggers."""
    if not isinstance(data, list | tuple):
        raise OptionError(f"sim.disturb is {data!r:.60}, expected a list")
    disturbances: list[Disturbance] = []
    for i, item in enumerate(data):
        name = f"sim.disturb[{i}]"
        check_keys(name, item, [entry.name for entry in fields(Disturbance)])
        _one_of(f"disturb[{i}].side", item.get("side"), DEVICES)
        disturbances.append(
            _built(name, Disturbance, {k: tuple(v) if isinstance(v, list) else v for k, v in item.items()})
        )
    return tuple(sorted(disturbances, key=lambda disturbance: disturbance.at))


def _faults(data: Mapping[str, Any], seed: int) -> FaultPlan:
    """Rates by kind, ``extra_first: left|right``, ``seed``, and ``script``: a list of {kind, at, side, length}."""
    check_keys("sim.faults", data, [*RANDOM_KINDS, "extra_first", "seed", "script"])
    script = [_fault(i, item) for i, item in enumerate(data.get("script", ()))]
    extra = data.get("extra_first")
    if extra:
        _one_of("faults.extra_first", extra, get_args(Side))
        script.append(Fault(FaultKind.EXTRA_FIRST, 0, extra))
    rates = {kind: data[kind] for kind in RANDOM_KINDS if kind in data}
    plan: FaultPlan = _built(
        "sim.faults", FaultPlan, {"scripted": tuple(script), "rates": rates, "seed": data.get("seed", seed)}
    )
    return plan


def _fault(i: int, data: Mapping[str, Any]) -> Fault:
    name = f"faults.script[{i}]"
    check_keys(f"sim.{name}", data, [item.name for item in fields(Fault)])
    _one_of(f"{name}.kind", data.get("kind"), tuple(FaultKind))
    fault: Fault = _built(f"sim.{name}", Fault, {"at": 0, **data, "kind": FaultKind(data["kind"])})
    if fault.side is not None:
        _one_of(f"{name}.side", fault.side, get_args(Side))
    return replace(fault, at=int(fault.at), length=int(fault.length))


def check_keys(name: str, data: object, keys: list[str]) -> None:
    """OptionError unless ``data`` is a mapping with some of these keys; ``name``: of the mapping in the message."""
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


def _built(name: str, make: Any, values: dict[str, Any]) -> Any:
    """Create an object; errors about its values become OptionErrors that name the option."""
    try:
        return make(**values)
    except OptionError:
        raise
    except (TypeError, ValueError) as error:
        raise OptionError(f"{name}: {error}") from error
