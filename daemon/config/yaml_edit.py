"""Change of one value in a YAML text; comments, order and layout stay."""

from __future__ import annotations

import copy
import re
from typing import Any

from daemon.common.errors import DaemonError
from daemon.config.yaml_source import KeyPath, read_yaml


def with_value(text: str, path: KeyPath, value: float) -> str:
    """Return the text with a number set at a path of keys; a new key is inserted first in its section.

    Raises:
        DaemonError: the section does not exist, or its layout is not supported.
    """
    source = read_yaml(text)
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
            f"{'.'.join(map(str, path))} cannot be set by itself in this file; write {key}: {value:g} there"
        )
    return changed


def _replaced(text: str, position: tuple[int, int], value: float) -> str:
    lines = text.splitlines(keepends=True)
    line, column = position[0] - 1, position[1] - 1
    lines[line] = lines[line][:column] + re.sub(r"^[^\s,}#]+", f"{value:g}", lines[line][column:])
    return "".join(lines)


def _inserted(text: str, source: Any, above: KeyPath, value: float, key: str | int) -> str:
    lines = text.splitlines(keepends=True)
    row, column = source.positions[above]
    line = lines[row - 1]
    if line[column - 1 : column] == "{":
        more = "" if line[column:].lstrip().startswith("}") else ", "
        lines[row - 1] = f"{line[:column]}{key}: {value:g}{more}{line[column:]}"
    else:
        lines.insert(row - 1, f"{' ' * (column - 1)}{key}: {value:g}\n")
    return "".join(lines)
