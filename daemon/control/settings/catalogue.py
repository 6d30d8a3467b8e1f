"""The catalogue of settings: value, type, bounds, unit, meaning, and whether a setting changes live."""

from __future__ import annotations

import ast
import functools
import inspect
from dataclasses import asdict
from typing import Any

from daemon.config.rig_config import RigConfig
from daemon.control.settings.flatten import PIPELINE, leaves
from daemon.control.settings.live_settings import BY_FILE, is_live
from pipeline.common import settings as pipeline_settings
from pipeline.common.settings import LIMITS, Settings

_BOUNDS = {
    "minimum": "min",
    "maximum": "max",
    "exclusiveMinimum": "above",
    "exclusiveMaximum": "below",
    "enum": "choices",
    "minItems": "least_items",
    "maxItems": "most_items",
    "pattern": "pattern",
}
_SUFFIXES = {
    "us": "µs",
    "ms": "ms",
    "s": "s",
    "hz": "Hz",
    "mb": "MB",
    "mm": "mm",
    "px": "px",
    "rad": "rad",
    "c": "°C",
    "percent": "%",
    "days": "d",
    "hours": "h",
}
_UNITS = dict.fromkeys(("window_radius", "window_sigma", "lattice_x", "lattice_y"), "px") | {
    "min_modulation": "counts",
    "saturation": "counts",
    "read_noise": "counts",
    "consistency_threshold": "rad",
    "outlier_phase_threshold": "rad",
    "reflection_threshold": "rad",
    "cluster_phase_threshold": "rad",
    "cost_sigma": "rad",
    "cluster_min_area": "pixels",
    "hole_filling_size": "px",
    **dict.fromkeys(("roi_column_min", "roi_column_max", "roi_row_min", "roi_row_max"), "px"),
    "downsampling": "px",
    "fusion_clouds": "clouds",
    "self_calibration_range": "projector px",
}


def catalogue(config: RigConfig, settings: Settings, below: str = "") -> list[dict[str, Any]]:
    """Return a row for every setting at or below a path, in the order of rig.yaml.

    Keys: ``path``, ``value``, ``type``, ``live``, ``doc`` and, where there are any, ``by_file`` (live by reload only),
    ``unit``, ``default``, ``min``, ``max``, ``above``, ``below`` (bounds that are not allowed themselves), ``choices``,
    ``pattern``.
    """
    return [
        {"path": path, "value": value, "live": is_live(path)}
        | ({"by_file": True} if path in BY_FILE else {})
        | _description(path)
        for path, value in leaves(config, settings).items()
        if not below or path == below or path.startswith(below + ".")
    ]


def _description(path: str) -> dict[str, Any]:
    if path.startswith(PIPELINE + "."):
        return _of_pipeline(path.removeprefix(PIPELINE + "."))
    return _of_schema(path)


@functools.cache
def _schema() -> dict[str, Any]:
    return RigConfig.model_json_schema()


@functools.cache
def _of_schema(path: str) -> dict[str, Any]:
    """Describe a setting from the schema of rig.yaml."""
    node = _schema()
    for part in path.split("."):
        section = next((kind for kind in _kinds(node) if part in kind.get("properties", {})), {})
        node = section.get("properties", {}).get(part, {})
    kinds, name = _kinds(node), path.rpartition(".")[2]
    row: dict[str, Any] = {"type": " or ".join(dict.fromkeys(str(kind.get("type", "string")) for kind in kinds))}
    for kind in kinds:
        row |= {ours: kind[theirs] for theirs, ours in _BOUNDS.items() if theirs in kind}
    row |= {"default": node["default"]} if "default" in node else {}
    row |= {"unit": _SUFFIXES[end]} if (end := name.rpartition("_")[2]) in _SUFFIXES and end != name else {}
    return row | {"doc": next((text for text in (one.get("description") for one in (node, *kinds)) if text), "")}


def _kinds(node: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the alternatives of a value: the branches of a union, references resolved."""
    if "$ref" in node:
        return _kinds(_schema()["$defs"][node["$ref"].rpartition("/")[2]])
    inner = node.get("anyOf", node.get("oneOf"))
    if inner is None:
        return [node]
    doc = {"description": node["description"]} if "description" in node else {}
    return [doc | kind for branch in inner for kind in _kinds(branch)]


def _of_pipeline(name: str) -> dict[str, Any]:
    default = asdict(Settings())[name]
    row: dict[str, Any] = {"type": _JSON[type(default)], "default": default}
    if name in LIMITS:
        row |= dict(zip(("min", "max"), LIMITS[name], strict=True))
    unit = _UNITS.get(name, _SUFFIXES.get(name.rpartition("_")[2]))
    return row | ({"unit": unit} if unit else {}) | {"doc": _docs().get(name, "")}


_JSON = {bool: "boolean", int: "integer", float: "number"}


@functools.cache
def _docs() -> dict[str, str]:
    """Return the docstrings of the pipeline's settings, which Python keeps in the source only."""
    try:
        (definition,) = (
            node
            for node in ast.parse(inspect.getsource(pipeline_settings)).body
            if isinstance(node, ast.ClassDef) and node.name == Settings.__name__
        )
    except (OSError, ValueError):
        return {}
    docs = {}
    for field, text in zip(definition.body, definition.body[1:], strict=False):
        match field, text:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(doc))):
                docs[name] = " ".join(doc.split())
    return docs
