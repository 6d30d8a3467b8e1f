"""Change of one value in a YAML text; comments, order and layout stay."""

from __future__ import annotations

import copy
import json
import re
from typing import Any

from daemon.common.errors import DaemonError
from daemon.config.yaml_source import KeyPath, read_yaml


def with_value(text: str, path: KeyPath, value: Any, *, create: bool = False) -> str:
    """Return the text with a value set at a path of keys; a new key is inserted first in its section.

    Args:
        value: a number, true, false, text or a list; create: make sections that are missing.

    Raises:
        DaemonError: the section does not exist, or its layout is not supported.
    """
    source = read_yaml(text)
    while create and len(path) > 1 and not _exists(source.data, path[:-1]):
        path, value = path[:-1], {path[-1]: value}
    above, key = path[:-1], path[-1]
    section = source.data
    for name in above:
        section = section.get(name) if isinstance(section, dict) else None
    if not isinstance(section, dict) or (not section and above not in source.positions):
        raise DaemonError(f"there is no section {'.'.join(map(str, above))} to put {key} into")
    expected = copy.deepcopy(source.data)
    target = expected
    for name in above:
        target = target[name]
    target[key] = value
    changed = (
        _replaced(text, source.positions[path], value) if key in section else _inserted(text, source, above, value, key)
    )
    if read_yaml(changed).data != expected:
        raise DaemonError(
            f"{'.'.join(map(str, path))} cannot be set by itself in this file; write {key}: {_text(value)} there"
        )
    return changed


def _exists(data: Any, path: KeyPath) -> bool:
    for name in path:
        data = data.get(name) if isinstance(data, dict) else None
    return data is not None


def _text(value: Any) -> str:
    """A value on one line of YAML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_text(item)}" for key, item in value.items()) + "}"
    if isinstance(value, float):
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    if isinstance(value, str) and re.fullmatch(r"[A-Za-z][\w-]*", value) and value.lower() not in _RESERVED:
        return value
    return json.dumps(value, ensure_ascii=False)


_RESERVED = {"true", "false", "yes", "no", "on", "off", "y", "n", "null"}
"""What YAML 1.1 does not read as text."""


def _replaced(text: str, position: tuple[int, int], value: Any) -> str:
    lines = text.splitlines(keepends=True)
    line, column = position[0] - 1, position[1] - 1
    lines[line] = lines[line][:column] + re.sub(r"^[^\s,}#]+", lambda _: _text(value), lines[line][column:])
    return "".join(lines)


def _inserted(text: str, source: Any, above: KeyPath, value: Any, key: str | int) -> str:
    lines = text.splitlines(keepends=True)
    row, column = source.positions[above]
    line = lines[row - 1]
    if line[column - 1 : column] == "{":
        more = "" if line[column:].lstrip().startswith("}") else ", "
        lines[row - 1] = f"{line[:column]}{key}: {_text(value)}{more}{line[column:]}"
    else:
        lines.insert(row - 1, f"{' ' * (column - 1)}{key}: {_text(value)}\n")
    return "".join(lines)
