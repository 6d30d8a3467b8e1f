"""Presets: named choices of overload, temporal fusion and pipeline settings, beneath what rig.yaml sets itself.

Those of a user are files ``presets/NAME.yaml`` beside rig.yaml: ``fringed_preset: 1`` and any of the keys ``overload``,
``temporal`` and ``settings`` of the section ``pipeline``.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daemon.common.errors import InputError
from daemon.common.files import read_at_most
from daemon.config.yaml_source import read_yaml
from pipeline.common.errors import PipelineError
from pipeline.common.settings import RENAMED, Settings

BUILT_IN: dict[str, dict[str, Any]] = {
    "precise": {
        "temporal": "fuse",
        "settings": {"smoothing_sigma_px": 0.7, "noise_threshold_mm": 0.5, "cluster_min_area": 240},
    },
    "balanced": {},
    "fast": {"overload": "half", "settings": {"lattice_x": 6, "lattice_y": 6}},
    "dynamic": {"overload": "half", "settings": {"hole_filling_size": 4}},
}
"""``balanced`` are the defaults."""
MEANINGS = {
    "precise": "parts at rest: clouds averaged, smoothed along the surface, without points of large noise",
    "balanced": "the defaults",
    "fast": "orders searched on a coarser lattice, half resolution under load",
    "dynamic": "moving parts: every pair measured, at half resolution under load; small holes filled",
}
DEFAULT = "balanced"
KEYS: dict[str, Any] = {"overload": "skip", "temporal": "off", "settings": {}}
"""Keys of a preset, those of the section ``pipeline``, with their defaults."""
FOLDER = "presets"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
_LIMIT = 1 << 16


def preset_names(base_dir: Path) -> list[str]:
    """Every preset, the user's own after the built-in ones."""
    own = sorted(path.stem for path in (base_dir / FOLDER).glob("*.yaml") if NAME.fullmatch(path.stem))
    return [*BUILT_IN, *(name for name in own if name not in BUILT_IN)]


def preset_path(name: str, base_dir: Path) -> Path:
    """The file of an own preset.

    Raises:
        InputError: a name that is built in, or that is none.
    """
    if name in BUILT_IN:
        raise InputError(f"preset {name} is built in; choose another name")
    if not NAME.fullmatch(name):
        raise InputError(f"preset name {name!r:.60}: a name has 1 to 32 letters, digits, _ or -")
    return base_dir / FOLDER / f"{name}.yaml"


def read_preset(name: str, base_dir: Path) -> dict[str, Any]:
    """The values of a preset by the keys of the section ``pipeline``.

    Raises:
        InputError: an unknown preset, or a file that is none; names the known ones, or the mistake.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    names = preset_names(base_dir)
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(names)}"
        raise InputError(f"there is no preset {name!r:.60}; {hint}")
    path = preset_path(name, base_dir)
    source = read_yaml(read_at_most(path, _LIMIT, InputError).decode("utf-8", errors="replace"))
    if source.problems:
        first = source.problems[0]
        raise InputError(f"{path}:{first.line}:{first.column}: {first.message}")
    return _checked(source.data, str(path))


def _checked(values: Any, name: str) -> dict[str, Any]:
    if not isinstance(values, dict) or values.get("fringed_preset") != 1:
        raise InputError(f"{name}: not a preset; it needs the key fringed_preset: 1")
    unknown = [key for key in values if key not in (*KEYS, "fringed_preset", "description")]
    if unknown:
        raise InputError(f"{name}: unknown key {unknown[0]!r:.60}; known here: {', '.join(KEYS)}")
    settings = values.get("settings", {})
    if not isinstance(settings, dict):
        raise InputError(f"{name}: settings must be a section")
    try:
        Settings().with_overrides(settings)
    except PipelineError as error:
        raise InputError(f"{name}: {error}") from error
    return {key: values[key] for key in KEYS if key in values}


def expanded(data: Any, base_dir: Path) -> Any:
    """The values of rig.yaml with those of its preset added where the file has none.

    Raises:
        InputError: see :func:`read_preset`.
    """
    name = data.get("preset", DEFAULT) if isinstance(data, dict) else DEFAULT
    if name == DEFAULT or not isinstance(name, str):
        return data
    preset = read_preset(name, base_dir)
    pipeline = data.get("pipeline", {})
    if not preset or not isinstance(pipeline, dict):
        return data
    merged = preset | pipeline
    if isinstance(pipeline.get("settings", {}), dict):
        merged["settings"] = _beneath(preset.get("settings", {}), pipeline.get("settings", {}))
    return data | {"pipeline": merged}


def _beneath(preset: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a file over those of a preset; a former name replaces the present one, too."""
    present = {RENAMED.get(name, name) for name in own}
    return {name: value for name, value in preset.items() if RENAMED.get(name, name) not in present} | dict(own)
