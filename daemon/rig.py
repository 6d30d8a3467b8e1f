"""The devices of a rig and what is known of them, put together from rig.yaml."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from daemon.config import registry
from daemon.config.models import RigConfig
from daemon.errors import ConfigError
from drivers.protocols import Camera, Projector, Side
from pipeline.calibration import Calibration
from pipeline.calibration import from_mapping as calibration_from_mapping
from pipeline.cloud import Volume
from pipeline.errors import PipelineError
from pipeline.pattern import ColorFringe
from pipeline.pattern import from_mapping as pattern_from_mapping

Progress = Callable[[int, int], None]


class OptionsError(ConfigError):
    """Options that a driver refuses: ``path`` names the key as well as the driver's message tells it."""

    def __init__(self, section: str, message: str) -> None:
        named = re.match(r"(?:sim|cameras|projector)\.([A-Za-z0-9_.\[\]]+)", message)
        keys = re.findall(r"[A-Za-z_]\w*|\d+", named.group(1)) if named else []
        self.path = (section, *(int(key) if key.isdigit() else key for key in keys))
        self.message = re.sub(r"^sim\b", section, message)
        super().__init__([f"{section}: {self.message}"])


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Everything a measurement stands on.

    Args:
        cameras: left and right, closed; projector: closed.
        calibration_data: the bytes of the calibration file; identity: their digest, ``sha256:...``.
        release: lets go of all devices.
    """

    cameras: Mapping[Side, Camera]
    projector: Projector
    calibration: Calibration
    pattern: ColorFringe
    volume: Volume
    calibration_data: bytes
    identity: str
    release: Callable[[], None]


def open_rig(config: RigConfig, base_dir: Path, *, progress: Progress | None = None) -> Rig:
    """Make the devices that rig.yaml names and read the files it names.

    Raises:
        OptionsError: options that the driver refuses; ConfigError: a file that does not fit.
        DaemonError: a driver that cannot be loaded.
    """
    opener = registry.load(registry.RIGS[config.cameras.driver])
    try:
        devices = opener(_options(config), base_dir, progress=progress)
    except (ValueError, TypeError) as error:
        raise OptionsError(_section(config), str(error)) from error
    try:
        data = _calibration_data(config, base_dir, devices)
        return Rig(
            cameras=devices.cameras,
            projector=devices.projector,
            calibration=_parsed(data, config.calibration or "the driver's calibration"),
            pattern=_pattern(config, base_dir, devices),
            volume=_volume(config, base_dir, devices),
            calibration_data=data,
            identity=f"sha256:{hashlib.sha256(data).hexdigest()}",
            release=devices.close,
        )
    except BaseException:
        devices.close()
        raise


def _section(config: RigConfig) -> str:
    return "simulation" if config.cameras.driver == "sim" else "cameras"


def _options(config: RigConfig) -> dict[str, Any]:
    if config.cameras.driver == "sim":
        return dict(config.simulation)
    projector = config.projector.model_dump() if config.projector else {}
    return {"cameras": config.cameras.model_dump(), "projector": projector}


def _calibration_data(config: RigConfig, base_dir: Path, devices: Any) -> bytes:
    if config.calibration is not None:
        return config.path(config.calibration, base_dir).read_bytes()
    return yaml.safe_dump(dict(devices.calibration), sort_keys=False).encode()


def _parsed(data: bytes, name: str) -> Calibration:
    try:
        mapping = yaml.safe_load(data)
        if not isinstance(mapping, dict):
            raise ConfigError([f"{name}: not a calibration file"])
        return calibration_from_mapping(mapping)
    except yaml.YAMLError as error:
        raise ConfigError([f"{name}: YAML syntax: {' '.join(str(error).split())}"]) from error
    except PipelineError as error:
        raise ConfigError([f"{name}: {error}"]) from error


def _json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError([f"{path}: not JSON: {error}"]) from error
    if not isinstance(value, dict):
        raise ConfigError([f"{path}: expected a JSON object"])
    return value


def _pattern(config: RigConfig, base_dir: Path, devices: Any) -> ColorFringe:
    given = config.pattern if config.pattern is not None else devices.pattern
    return pattern_from_mapping(_json(config.path(given, base_dir)) if isinstance(given, str) else given)


def _volume(config: RigConfig, base_dir: Path, devices: Any) -> Volume:
    given = config.volume if config.volume is not None else devices.volume
    if isinstance(given, str):
        given = _json(config.path(given, base_dir))
    values = given if isinstance(given, Mapping) else given.model_dump()
    try:
        return Volume(float(values["near_mm"]), float(values["far_mm"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError([f"volume: {error}; expected near_mm and far_mm, millimetres"]) from error
