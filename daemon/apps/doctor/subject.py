"""The checked machine and rig; values that several checks need are read once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from daemon.apps.doctor.machine import Machine
from daemon.config.rig_config import RigConfig
from drivers.errors import DriverError
from drivers.genicam.options import Options as GenicamOptions
from drivers.projector.options import ExternalOptions, ProjectorOptions, read
from drivers.protocols import SIDES, Side
from drivers.v4l2.options import Options as V4l2Options

if TYPE_CHECKING:
    from daemon.rig.calibration_file import CalibrationFile
    from drivers.genicam import DetectedCamera
    from drivers.projector import DetectedOutput
    from sim.devices.options import SimOptions

Size = tuple[int, int]
CameraOptions: TypeAlias = GenicamOptions | V4l2Options


class Subject:
    """A machine with or without a rig.

    Args:
        path: of the rig.yaml, None without one; config: its contents, None if it is unreadable.
    """

    def __init__(self, machine: Machine, path: Path | None = None, config: RigConfig | None = None) -> None:
        self.machine, self.path, self.config = machine, path, config
        self.base_dir = path.resolve().parent if path is not None else Path.cwd()

    @property
    def drivers(self) -> set[str]:
        """The drivers that the rig names; empty without a rig."""
        if self.config is None:
            return set()
        projector = self.config.projector
        return {self.config.cameras.driver} | ({projector.driver} if projector is not None else set())

    def uses(self, driver: str) -> bool:
        """Whether the rig names that driver."""
        return driver in self.drivers

    def options(self, side: Side) -> dict[str, Any]:
        """The unchecked options of a camera."""
        if self.config is None:
            return {}
        return self.config.cameras.left if side == "left" else self.config.cameras.right

    @cached_property
    def cameras(self) -> dict[Side, CameraOptions]:
        """The valid options of the cameras; invalid ones are reported by the area rig."""
        if self.config is None or self.config.cameras.driver not in ("genicam", "v4l2"):
            return {}
        parse = options_parser(self.config.cameras.driver)
        cameras: dict[Side, CameraOptions] = {}
        for side in SIDES:
            try:
                cameras[side] = parse(side, self.options(side))
            except ValueError:
                continue
        return cameras

    @cached_property
    def projector(self) -> ProjectorOptions | ExternalOptions | None:
        """The options of the projector, None if they are missing or invalid."""
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
    def simulation(self) -> SimOptions | None:
        """The options of a simulated rig, None for other rigs."""
        if self.config is None or self.config.cameras.driver != "sim":
            return None
        from sim.devices.options import from_mapping

        try:
            return from_mapping(dict(self.config.simulation), self.base_dir)
        except ValueError:
            return None

    @cached_property
    def producers(self) -> list[Path]:
        """The existing GenTL producers of the environment and of rig.yaml."""
        from drivers.genicam.options import producers

        existing: dict[Path, None] = {}
        named = [camera.producer for camera in self.cameras.values() if isinstance(camera, GenicamOptions)]
        for producer in named if self.uses("genicam") else [None]:
            try:
                existing.update(dict.fromkeys(producers(producer, self.base_dir, self.machine.environ)))
            except (ValueError, OSError):
                continue
        return list(existing)

    @cached_property
    def cameras_by_producer(self) -> dict[Path, list[DetectedCamera] | str]:
        """The cameras of each producer, or the reason for a failure."""
        from drivers.genicam import discover

        cameras: dict[Path, list[DetectedCamera] | str] = {}
        for producer in self.producers:
            try:
                cameras[producer] = discover([producer])
            except (DriverError, OSError) as error:
                cameras[producer] = str(error)
        return cameras

    @property
    def genicam(self) -> list[DetectedCamera]:
        """All connected GenICam cameras."""
        return [
            camera
            for cameras in self.cameras_by_producer.values()
            if not isinstance(cameras, str)
            for camera in cameras
        ]

    @cached_property
    def outputs(self) -> list[DetectedOutput]:
        """The outputs of the rig's display, or the environment's; DriverError if it is unreadable."""
        from drivers.projector import outputs

        return outputs(self.projector.display if isinstance(self.projector, ProjectorOptions) else "")

    @cached_property
    def refresh_hz(self) -> float:
        """Refresh rate of the projector, 0 if unknown."""
        from drivers.projector.x11.detected_output import find_output

        if self.projector is None:
            return 0.0
        if isinstance(self.projector, ProjectorOptions):
            try:
                output = find_output(self.outputs, self.projector.output)
            except DriverError:
                output = None
            if output is not None and output.refresh_hz:
                return float(output.refresh_hz)
        return float(self.projector.refresh_hz or 0.0)

    @cached_property
    def calibration(self) -> CalibrationFile | None:
        """The calibration that rig.yaml names, None if it names none; PipelineError if it is unusable."""
        from daemon.rig.calibration_file import read_calibration

        if self.config is None or self.config.calibration is None:
            return None
        return read_calibration(self.config.path(self.config.calibration, self.base_dir))


def options_parser(driver: str) -> Callable[[Side, dict[str, Any]], CameraOptions]:
    """The function that checks the options of a camera driver."""
    if driver == "genicam":
        from drivers.genicam.options import parse

        return parse
    from drivers.v4l2.options import from_mapping

    return from_mapping
