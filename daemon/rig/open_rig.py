"""The devices of a rig and its files, opened as rig.yaml names them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from daemon.common.errors import ConfigError
from daemon.config import driver_table
from daemon.config.rig_config import RigConfig
from daemon.config.yaml_source import read_yaml
from daemon.rig.calibration_file import CalibrationFile, parse_calibration, read_calibration
from daemon.rig.camera_serials import serials_in
from daemon.rig.pattern_file import read_pattern, read_volume
from daemon.rig.pose_file import output_pose
from drivers.protocols import SIDES, Camera, Devices, MovesBoard, Projector, Side
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.color_fringe import from_mapping as pattern_from_mapping
from pipeline.rig.calibration import Calibration
from pipeline.rig.plausibility import check_volume
from pipeline.rig.pose import Pose
from pipeline.rig.volume import Volume

Progress = Callable[[int, int], None]


_SECTIONS = {"sim": ("simulation",), "cameras": ("cameras",), "projector": ("projector", "options")}
"""Sections of rig.yaml that a driver's message calls by a shorter name."""


class OptionsError(ConfigError):
    """Options that a driver rejects; ``path`` is the key, as far as the driver's message names it."""

    def __init__(self, section: str, message: str) -> None:
        named = re.match(r"(sim|cameras|projector)\.([A-Za-z0-9_.\[\]]+)", message)
        keys = re.findall(r"[A-Za-z_]\w*|\d+", named.group(2)) if named else []
        above = _SECTIONS[named.group(1)] if named else (section,)
        self.path = (*above, *(int(key) if key.isdigit() else key for key in keys))
        self.message = ".".join(above) + message[len(named.group(1)) :] if named else message
        super().__init__([f"{section}: {self.message}"])

    def located(self, path: Path) -> ConfigError:
        """The same error with its line and column in the rig file."""
        source = read_yaml(path.read_text(encoding="utf-8"))
        line, column = source.position(self.path, key=self.path in source.keys)
        return ConfigError([f"{path}:{line}:{column}: {self.message}"])


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Devices, calibration, pattern and volume.

    Args:
        cameras: left and right, closed; projector: closed.
        calibration_data: the bytes of the calibration file; identity: their digest, ``sha256:...``.
        release: closes all devices.
        board: of a simulated rig, None where a person moves it.
        serials: of the calibrated cameras, where the calibration file has them.
        pose: into the output frame, None = clouds are in the left camera's.
    """

    cameras: Mapping[Side, Camera]
    projector: Projector
    calibration: Calibration
    pattern: ColorFringe
    volume: Volume
    calibration_data: bytes
    identity: str
    release: Callable[[], None]
    board: MovesBoard | None = None
    serials: Mapping[Side, str] = field(default_factory=dict)
    pose: Pose | None = None


def open_rig(config: RigConfig, base_dir: Path, *, progress: Progress | None = None) -> Rig:
    """Make the devices that rig.yaml names and read the files it names.

    Raises:
        OptionsError: options that the driver rejects; PipelineError: a file that does not fit.
        DaemonError: a driver that cannot be loaded.
    """
    devices = open_devices(config, base_dir, progress=progress)
    try:
        calibration, volume = _calibration(config, base_dir, devices), _volume(config, base_dir, devices)
        check_volume(calibration.calibration.left, calibration.calibration.right, volume)
        return Rig(
            cameras=devices.cameras,
            projector=devices.projector,
            calibration=calibration.calibration,
            pattern=_pattern(config, base_dir, devices),
            volume=volume,
            calibration_data=calibration.data,
            identity=calibration.identity,
            release=devices.close,
            board=devices.board,
            serials=serials_in(calibration.mapping["cameras"]),
            pose=output_pose(config, base_dir),
        )
    except BaseException:
        devices.close()
        raise


@dataclass(frozen=True, slots=True, eq=False)
class _Devices:
    """Cameras of one driver and a projector of another."""

    cameras: Mapping[Side, Camera]
    projector: Projector
    board: MovesBoard | None = None

    def close(self) -> None:
        for camera in self.cameras.values():
            camera.close()
        self.projector.close()


def open_devices(config: RigConfig, base_dir: Path, *, progress: Progress | None = None) -> Devices:
    """Make cameras and projector of rig.yaml, closed, without its other files.

    Raises:
        OptionsError: options that the driver rejects. DaemonError: a driver that cannot be loaded.
    """
    try:
        return _devices(config, base_dir, progress)
    except (ValueError, TypeError) as error:
        raise OptionsError(_section(config), str(error)) from error


def check_options(config: RigConfig, base_dir: Path) -> None:
    """Check the drivers' options; touches no device.

    Raises:
        OptionsError: as :func:`open_devices`.
    """
    if config.cameras.driver in driver_table.CAMERAS:
        open_devices(config, base_dir).close()
    elif config.cameras.driver == "sim":
        try:
            driver_table.load(driver_table.SIM_OPTIONS)(config.simulation, base_dir)
        except (ValueError, TypeError) as error:
            raise OptionsError("simulation", str(error)) from error


def _devices(config: RigConfig, base_dir: Path, progress: Progress | None) -> Devices:
    """The devices of a whole rig's driver, or those of a camera driver and a projector driver."""
    name, projector = config.cameras.driver, config.projector
    if name in driver_table.RIGS:
        devices: Devices = driver_table.load(driver_table.RIGS[name])(_options(config), base_dir, progress=progress)
        return devices
    if projector is None or projector.driver not in driver_table.PROJECTORS:
        raise ValueError(f"projector.driver is missing, expected one of: {', '.join(driver_table.PROJECTORS)}")
    open_camera = driver_table.load(driver_table.CAMERAS[name])
    open_projector = driver_table.load(driver_table.PROJECTORS[projector.driver])
    options: dict[Side, dict[str, Any]] = {"left": config.cameras.left, "right": config.cameras.right}
    return _Devices(
        {side: open_camera(side, options[side], base_dir) for side in SIDES},
        open_projector(projector.options, base_dir),
    )


def _section(config: RigConfig) -> str:
    return "simulation" if config.cameras.driver == "sim" else "cameras"


def _options(config: RigConfig) -> dict[str, Any]:
    if config.cameras.driver == "sim":
        # A loop that was rendered beforehand shows one image; the frames of a set are rendered when they are shown.
        return ({} if config.mode == "single" else {"live": True}) | dict(config.simulation)
    projector = config.projector.model_dump() if config.projector else {}
    return {"cameras": config.cameras.model_dump(), "projector": projector}


def _calibration(config: RigConfig, base_dir: Path, devices: Any) -> CalibrationFile:
    if config.calibration is not None:
        return read_calibration(config.path(config.calibration, base_dir))
    data = yaml.safe_dump(dict(devices.calibration), sort_keys=False).encode()
    return parse_calibration(data, "the driver's calibration")


def _pattern(config: RigConfig, base_dir: Path, devices: Any) -> ColorFringe:
    if isinstance(config.pattern, str):
        return read_pattern(config.path(config.pattern, base_dir))
    return pattern_from_mapping(config.pattern if config.pattern is not None else devices.pattern)


def _volume(config: RigConfig, base_dir: Path, devices: Any) -> Volume:
    if isinstance(config.volume, str):
        return read_volume(config.path(config.volume, base_dir))
    if config.volume is not None:
        return Volume(config.volume.near_mm, config.volume.far_mm)
    return Volume(float(devices.volume["near_mm"]), float(devices.volume["far_mm"]))
