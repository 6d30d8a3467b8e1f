"""Reader of rig.yaml: all mistakes at once, each with file:line:column and, for a mistyped key, a suggestion."""

from __future__ import annotations

import difflib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from daemon.common.errors import ConfigError, InputError
from daemon.config.checks import semantic_problems
from daemon.config.presets import expanded
from daemon.config.rig_config import RigConfig
from daemon.config.yaml_source import KeyPath, Source, read_yaml

MAX_BYTES = 1 << 20
_BRANCHES = ("path", "inline", "bool", "int", "float")


def load_rig(path: Path, *, complete: bool = True) -> RigConfig:
    """Read the rig of a file.

    Args:
        complete: whether calibration, pattern and volume are required; a rig before its calibration has none.

    Raises:
        ConfigError: with every mistake, one line each.
        OSError: the file cannot be read.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ConfigError([f"{path}: {size} bytes, a rig file has at most {MAX_BYTES}"])
    try:
        text = path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError([f"{path}: not UTF-8 text (byte {error.start})"]) from error
    return _in_state_directory(parse_rig(text, name=str(path), base_dir=path.parent, complete=complete))


def _in_state_directory(config: RigConfig) -> RigConfig:
    """Place what a service writes below systemd's STATE_DIRECTORY, as it may not write beside rig.yaml."""
    state = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if not state:
        return config
    sections = {name: getattr(config, name) for name in ("recording", "selfcheck")}
    moved = {
        name: section.model_copy(update={"dir": str(Path(state) / Path(section.dir).expanduser())})
        for name, section in sections.items()
    }
    return config.model_copy(update=moved)


def parse_rig(text: str, *, name: str = "rig.yaml", base_dir: Path | None = None, complete: bool = True) -> RigConfig:
    """Parse the rig of a YAML text; messages begin with ``name``, relative paths start at ``base_dir``."""
    source = read_yaml(text)
    config = _validated(source, base_dir or Path(), complete=complete)
    if source.problems or config is None:
        ordered = sorted(set(source.problems), key=lambda p: (p.line, p.column, p.message))
        raise ConfigError([f"{name}:{p.line}:{p.column}: {p.message}" for p in ordered])
    return config


def check_rig(data: dict[str, Any], *, base_dir: Path) -> RigConfig:
    """Validate plain values by the rules of rig.yaml; messages have no line."""
    source = Source(data, positions=dict.fromkeys(_paths(data), (1, 1)))
    config = _validated(source, base_dir, complete=True)
    if source.problems or config is None:
        raise ConfigError(sorted({problem.message for problem in source.problems}))
    return config


def _paths(value: Any, above: KeyPath = ()) -> Iterator[KeyPath]:
    yield above
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield from _paths(item, (*above, key))


def _validated(source: Source, base_dir: Path, *, complete: bool) -> RigConfig | None:
    """Return the rig of a source; add its mistakes to the source's problems."""
    config: RigConfig | None = None
    if source.data is not None or not source.problems:
        data = source.data
        try:
            data = expanded(data, base_dir)
        except InputError as error:
            source.add_problem(("preset",), f"preset: {error}")
        try:
            config = RigConfig.model_validate_json(json.dumps(data))
        except ValidationError as error:
            _translate(error, source)
        if isinstance(source.data, dict):
            for path, message in semantic_problems(source.data, base_dir, complete=complete):
                if path not in source.unreadable:
                    source.add_problem(path, message)
    return config


def _translate(error: ValidationError, source: Source) -> None:
    for item in error.errors(include_url=False):
        if item["loc"][-1:] in (("bool",), ("int",)):
            continue  # branches of a union that ends with float: one problem is enough
        path = _real_path(item["loc"], source)
        if path in source.unreadable:
            continue
        dotted = ".".join(str(part) for part in path) or "the file"
        if item["type"] == "extra_forbidden":
            source.add_problem(path, f"unknown key {path[-1]!r}{_suggestion(path)}", key=True)
        elif item["type"] == "missing":
            source.add_problem(path[:-1], f"{dotted} is missing")
        else:
            value = "" if isinstance(item["input"], dict | list) else f", got {item['input']!r:.60}"
            source.add_problem(path, f"{dotted}: {_lower(item['msg'])}{value}{_number_hint(item)}")


def _real_path(loc: tuple[int | str, ...], source: Source) -> KeyPath:
    """Return the location without the names of union branches, which are not in the file; keep the last part."""
    path: KeyPath = ()
    for i, part in enumerate(loc):
        if (*path, part) in source.positions or (
            i == len(loc) - 1 and part not in ("path", "inline", "bool", "int", "float")
        ):
            path = (*path, part)
    return path


def _lower(message: str) -> str:
    return message[:1].lower() + message[1:]


def _number_hint(item: Any) -> str:
    """Return a hint where a number such as 1e3 is text in YAML 1.1."""
    if not isinstance(item["input"], str) or item["type"] not in ("float_type", "int_type"):
        return ""
    try:
        value = float(item["input"])
    except ValueError:
        return ""
    return f" as text; write {value:g} without quotes or exponent"


def _suggestion(path: KeyPath) -> str:
    keys = list(_fields(path[:-1]))
    near = difflib.get_close_matches(str(path[-1]), keys, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known here: {', '.join(keys)}"


def _fields(path: KeyPath) -> Iterator[str]:
    model: type[BaseModel] | None = RigConfig
    for part in path:
        field = model.model_fields.get(str(part)) if model else None
        model = _model_in(field.annotation) if field else None
    yield from (model.model_fields if model else ())


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = get_args(annotation) if isinstance(annotation, UnionType) or get_args(annotation) else ()
    return next((model for model in map(_model_in, inner) if model), None)
