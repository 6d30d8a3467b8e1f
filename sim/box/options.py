"""Options of the box: read from plain values and checked."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import yaml

from drivers.protocols import SIDES, Side
from sim.devices.options import OptionError, SimOptions, check_keys
from sim.devices.options import from_mapping as sim_from_mapping
from sim.devices.scene_options import scene_of
from sim.rig.layout import RigLayout

MAX_FILE_BYTES = 1 << 16
_CAMERA_STEP, _PROJECTOR_STEP = (4, 2), (8, 1)


@dataclass(frozen=True, slots=True)
class BoxOptions:
    """Options of a rig on emulated hardware.

    Args:
        simulation: scene, layout, optics, encoding, faults and rate, as of the simulated rig; ``rate_hz`` is the
            trigger rate, ``frames`` the number of instants of a moving scene. Image sizes are rounded down to sizes
            that cameras and X servers support.
        exposure_us: exposure time of the cameras, by default one period of the projector; readout_us: readout time
            of the sensor.
        drift_ppm: of the cameras' clocks.
        tolerance_us: of the daemon's pairing.
        tcp: port of the cloud stream on this machine, in addition to the socket in the box's folder; 0 = none.
        daemon: whether to start the daemon too.
        display: of an X server that runs already and has the outputs of ``sim.box.box.heads``; empty = start one.
        folder: of all files; a temporary one if None.
    """

    simulation: SimOptions = field(default_factory=lambda: small_simulation())
    exposure_us: float = 16_667.0
    readout_us: float = 1_000.0
    drift_ppm: Mapping[Side, float] = field(default_factory=lambda: dict.fromkeys(SIDES, 0.0))
    tolerance_us: float = 1_000.0
    tcp: int = 5555
    daemon: bool = True
    display: str = ""
    folder: Path | None = None

    def __post_init__(self) -> None:
        for key, low, high in (
            ("exposure_us", 10, 1e6),
            ("readout_us", 0, 1e6),
            ("tolerance_us", 1, 1e6),
            ("tcp", 0, 65535),
        ):
            value = getattr(self, key)
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise OptionError(f"box.{key} is {value!r}, expected a number from {low:g} to {high:g}")
        if int(self.tcp) != self.tcp:
            raise OptionError(f"box.tcp is {self.tcp}, expected a whole number")
        for side in SIDES:
            if abs(self.drift_ppm[side]) > 1000:
                raise OptionError(f"box.drift_ppm.{side} is {self.drift_ppm[side]}, expected -1000 to 1000")
        if not 0 < self.simulation.rate_hz <= 1000:
            raise OptionError(
                f"box.simulation.rate_hz is {self.simulation.rate_hz}, expected more than 0, at most 1000"
            )

    @property
    def layout(self) -> RigLayout:
        """The rig, with image sizes that cameras and X servers support."""
        return fitted(self.simulation.layout)

    @property
    def instants_s(self) -> tuple[float, ...]:
        """Times of the moving scene's instants, seconds."""
        simulation = self.simulation
        period_s = scene_of(simulation).period_s
        return tuple(period_s * k / simulation.frames for k in range(simulation.frames))


def small_simulation() -> SimOptions:
    """A quarter of the standard rig each way, measured a few times a second."""
    return SimOptions(layout=RigLayout().scaled(0.25), frames=12, rate_hz=4.0)


def fitted(layout: RigLayout) -> RigLayout:
    """The layout with sizes rounded down: cameras to multiples of 4 x 2 pixels, the projector to multiples of 8."""
    return replace(
        layout,
        camera_size=_rounded(layout.camera_size, _CAMERA_STEP),
        projector_size=_rounded(layout.projector_size, _PROJECTOR_STEP),
    )


def read(path: Path) -> BoxOptions:
    """Options of a YAML file; OptionError names the file and the key."""
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1)
        if len(text) > MAX_FILE_BYTES:
            raise OptionError(f"the file has more than {MAX_FILE_BYTES} bytes")
        data = yaml.safe_load(text)
        return from_mapping({} if data is None else data, path.parent)
    except (OptionError, yaml.YAMLError) as error:
        raise OptionError(f"{path}: {error}") from error


def from_mapping(data: Mapping[str, Any], base_dir: Path | None = None) -> BoxOptions:
    """Options of plain values; relative paths start at ``base_dir``. Errors name the key."""
    check_keys("box", data, [item.name for item in fields(BoxOptions)])
    values = {key: value for key, value in data.items() if value is not None}
    if "simulation" in values:
        given = values["simulation"]
        if not isinstance(given, Mapping):
            raise OptionError(f"box.simulation is {given!r:.60}, expected a mapping")
        values["simulation"] = sim_from_mapping(
            {"layout": {"scale": 0.25}, "frames": 12, "rate_hz": 4.0} | dict(given), base_dir
        )
    if "drift_ppm" in values:
        check_keys("box.drift_ppm", values["drift_ppm"], list(SIDES))
        if any(not isinstance(value, int | float) for value in values["drift_ppm"].values()):
            raise OptionError(f"box.drift_ppm is {values['drift_ppm']}, expected numbers")
        values["drift_ppm"] = dict.fromkeys(SIDES, 0.0) | values["drift_ppm"]
    if "folder" in values:
        values["folder"] = (base_dir or Path()) / Path(str(values["folder"])).expanduser()
    if not isinstance(values.get("daemon", True), bool):
        raise OptionError(f"box.daemon is {values['daemon']!r}, expected true or false")
    display = values.get("display", "")
    if not isinstance(display, str) or not re.fullmatch(r"|:\d{1,4}", display):
        raise OptionError(f"box.display is {display!r:.60}, expected a display of this machine like ':0'")
    return BoxOptions(**values)


def _rounded(size: tuple[int, int], step: tuple[int, int]) -> tuple[int, int]:
    return size[0] // step[0] * step[0], size[1] // step[1] * step[1]
