"""A configuration as a flat table of paths and values: differences of two, and one with a value changed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from daemon.config.load import check_rig
from daemon.config.presets import KEYS, read_preset
from daemon.config.rig_config import RigConfig
from pipeline.common.settings import RENAMED, Settings

PIPELINE = "pipeline.settings"


def leaves(config: RigConfig, settings: Settings) -> dict[str, Any]:
    """Return every setting by its path as plain values, the pipeline's with their defaults filled in."""
    return dict(_walk(config, "", settings))


def _walk(section: BaseModel, above: str, settings: Settings) -> Iterator[tuple[str, Any]]:
    for name in type(section).model_fields:
        path, value = f"{above}{name}", getattr(section, name)
        if path == PIPELINE:
            yield from ((f"{path}.{key}", item) for key, item in asdict(settings).items())
        elif isinstance(value, BaseModel) and path != "volume":
            yield from _walk(value, f"{path}.", settings)
        else:
            yield path, value.model_dump(mode="json") if isinstance(value, BaseModel) else value


def current_path(path: str) -> str:
    """Return the present path of a setting whose path is perhaps one of the last release."""
    above, _, name = path.rpartition(".")
    return f"{above}.{RENAMED[name]}" if above == PIPELINE and name in RENAMED else path


def settings_of(config: RigConfig) -> Settings:
    """Return the pipeline's settings of a configuration."""
    return Settings().with_overrides(config.pipeline.settings)


def differences(old: tuple[RigConfig, Settings], new: tuple[RigConfig, Settings]) -> list[str]:
    """Return the paths of the settings that differ, in the order of rig.yaml."""
    before, after = leaves(*old), leaves(*new)
    absent = object()
    return [p for p in dict.fromkeys((*before, *after)) if before.get(p, absent) != after.get(p, absent)]


def with_value(config: RigConfig, settings: Settings, path: str, value: Any, base_dir: Path) -> RigConfig:
    """Return the configuration with one setting changed, checked like a whole rig.yaml.

    Raises:
        ConfigError: a value that is invalid in rig.yaml.
    """
    data = config.model_dump(mode="json")
    if path == "preset":  # which returns to its own values what it has
        data["pipeline"] = {key: item for key, item in data["pipeline"].items() if key not in KEYS}
    else:
        base = Settings().with_overrides(read_preset(config.preset, base_dir).get("settings", {}))
        data["pipeline"]["settings"] = _changed(asdict(base), asdict(settings))
    *above, name = path.split(".")
    section = data
    for part in above:
        section = section[part]
    section[name] = json.loads(json.dumps(value))
    return check_rig(data, base_dir=base_dir)


def _changed(defaults: dict[str, Any], now: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in now.items() if value != defaults[name]}
