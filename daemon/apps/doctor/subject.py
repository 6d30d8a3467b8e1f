"""What the checks look at: the machine, and the rig if one is named; what several of them ask is asked once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.apps.doctor.machine import Machine
from daemon.config.rig_config import RigConfig
from drivers.errors import DriverError
from drivers.protocols import SIDES, Side

if TYPE_CHECKING:
    from daemon.rig.calibration_file import CalibrationFile
    from drivers.genicam import CameraFound
    from drivers.projector import OutputFound

Size = tuple[int, int]


class Subject:
    """A machine with or without a rig.

    Args:
        path: of the rig.yaml, None without one; config: what it says, None where it cannot be read.
    """

    def __init__(self, machine: Machine, path: Path | None = None, config: RigConfig | None = None) -> None:
        self.machine, self.path, self.config = machine, path, config
        self.base_dir = path.resolve().parent if path is not None else Path.cwd()

    @property
    def drivers(self) -> set[str]:
        """The drivers that the rig names; nothing without a rig."""
        if self.config is None:
            return set()
        projector = self.config.projector
        return {self.config.cameras.driver} | ({projector.driver} if projector is not None else set())

    def uses(self, driver: str) -> bool:
        """Whether the rig names that driver."""
        return driver in self.drivers

    def options(self, side: Side) -> dict[str, Any]:
        """The plain options of a camera."""
        return {} if self.config is None else getattr(self.config.cameras, side)

    @cached_property
    def cameras(self) -> dict[Side, Any]:
        """The checked options of the cameras, without those that are wrong (the area rig tells them)."""
        if self.config is None or self.config.cameras.driver not in ("genicam", "v4l2"):
            return {}
        parse = options_parser(self.config.cameras.driver)
        found: dict[Side, Any] = {}
        for side in SIDES:
            try:
                found[side] = parse(side, self.options(side))
            except ValueError:
                continue
        return found

    @cached_property
    def projector(self) -> Any:
        """The checked options of the projector, None where there are none or wrong ones."""
        from drivers.projector.options import ExternalOptions, ProjectorOptions, read

        section = self.config.projector if self.config is not None else None
        if section is None or section.driver not in ("x11", "external"):
            return None
        try:
            if section.driver == "x11":
                return read(ProjectorOptions, section.options)
            return read(ExternalOptions, section.options)
        except ValueError:
            return None

    @cached_property
    def simulation(self) -> Any:
        """The options of the simulated rig, None for another one."""
        if self.config is None or self.config.cameras.driver != "sim":
            return None
        from sim.devices.options import from_mapping

        try:
            return from_mapping(dict(self.config.simulation), self.base_dir)
        except ValueError:
            return None

    @cached_property
    def producers(self) -> list[Path]:
        """The GenTL producers of the environment and of rig.yaml that are there."""
        from drivers.genicam.options import producers

        found: dict[Path, None] = {}
        named = [camera.producer for camera in self.cameras.values()] if self.uses("genicam") else [None]
        for producer in named:
            try:
                found.update(dict.fromkeys(producers(producer, self.base_dir, self.machine.environ)))
            except (ValueError, OSError):
                continue
        return list(found)

    @cached_property
    def looked(self) -> dict[Path, list[CameraFound] | str]:
        """The cameras of each producer, or why it tells none."""
        from drivers.genicam import discover

        found: dict[Path, list[CameraFound] | str] = {}
        for producer in self.producers:
            try:
                found[producer] = discover([producer])
            except (DriverError, OSError) as error:
                found[producer] = str(error)
        return found

    @property
    def genicam(self) -> list[CameraFound]:
        """Every GenICam camera that is seen."""
        return [camera for cameras in self.looked.values() if not isinstance(cameras, str) for camera in cameras]

    @cached_property
    def outputs(self) -> list[OutputFound]:
        """The outputs of the rig's display, or the environment's; DriverError if it cannot be read."""
        from drivers.projector import outputs

        return outputs(self.projector.display if self.uses("x11") and self.projector is not None else "")

    @cached_property
    def refresh_hz(self) -> float:
        """Refresh rate of the projector, 0 where it cannot be known."""
        from drivers.projector.found import find

        if self.projector is None:
            return 0.0
        if self.uses("x11"):
            try:
                output = find(self.outputs, self.projector.output)
            except DriverError:
                output = None
            if output is not None and output.refresh_hz:
                return float(output.refresh_hz)
        return float(self.projector.refresh_hz or 0.0)

    @cached_property
    def calibration(self) -> CalibrationFile | None:
        """The calibration that rig.yaml names, None if it names none; PipelineError if it cannot be used."""
        from daemon.rig.calibration_file import read_calibration

        if self.config is None or self.config.calibration is None:
            return None
        return read_calibration(self.config.path(self.config.calibration, self.base_dir))


def options_parser(driver: str) -> Callable[[Side, dict[str, Any]], Any]:
    """The function that checks the options of a camera driver."""
    if driver == "genicam":
        from drivers.genicam.options import parse

        return parse
    from drivers.v4l2.options import from_mapping

    return from_mapping
