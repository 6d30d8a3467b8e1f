"""Every mistake in the options of a simulated rig, with the path of its value."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daemon.config import driver_table
from daemon.config.yaml_source import KeyPath

SECTION = "simulation"
_MOST = 50
_NAMED = re.compile(r"sim\.([A-Za-z0-9_.\[\]]+)")


def simulation_problems(data: dict[str, Any], base_dir: Path) -> Iterator[tuple[KeyPath, str]]:
    """Yield every mistake in the section; the simulator reports one at a time, and is asked again without it."""
    cameras, section = data.get("cameras"), data.get(SECTION)
    if not isinstance(cameras, dict) or cameras.get("driver") != "sim" or not isinstance(section, dict) or not section:
        return
    check, options = driver_table.load(driver_table.SIM_OPTIONS), copy.deepcopy(section)
    removed: list[KeyPath] = []
    for _ in range(_MOST):
        try:
            check(options, base_dir)
        except (ValueError, TypeError) as error:
            keys, message = named_keys(str(error))
            original = _original(keys, removed)
            yield (SECTION, *original), message.replace(_indices(keys), _indices(original), 1)
            if not _corrected(options, keys, removed):
                return
        else:
            return


def named_keys(message: str) -> tuple[KeyPath, str]:
    """The keys below the section that a message of the simulator names, and the message with the section's name."""
    match = _NAMED.match(message)
    keys = re.findall(r"[A-Za-z_]\w*|\d+", match[1]) if match else []
    text = SECTION + message.removeprefix("sim") if message.startswith(("sim.", "sim:")) else message
    return tuple(int(key) if key.isdigit() else key for key in keys), text


def _corrected(options: dict[str, Any], keys: KeyPath, removed: list[KeyPath]) -> bool:
    """Remove the value at a path, or the nearest one above it that is there; False if there is none.

    Of a list the whole item is removed, as its keys may be required, and added to ``removed``.
    """
    if keys == ("scene",) and (options.get("board") or options.get("hold")):
        options["scene"] = "board"  # the scene that was meant, so that its options are checked too
        return True
    item = next((i for i, key in enumerate(keys) if isinstance(key, int)), len(keys) - 1)
    for length in range(item + 1, 0, -1):
        above: Any = options
        for key in keys[: length - 1]:
            above = above.get(key) if isinstance(above, dict) else None
        key = keys[length - 1]
        if isinstance(above, dict) and key in above:
            del above[key]
            return True
        if isinstance(above, list) and isinstance(key, int) and key < len(above):
            removed.append(_original(keys[:length], removed))
            del above[key]
            return True
    return False


def _original(keys: KeyPath, removed: list[KeyPath]) -> KeyPath:
    """The path in the file: the index of a list's item is higher by the items removed before it."""
    for i, key in enumerate(keys):
        if isinstance(key, int):
            for gone in sorted(path[i] for path in removed if path[:i] == keys[:i] and len(path) == i + 1):
                key += isinstance(gone, int) and gone <= key
            return (*keys[:i], key, *keys[i + 1 :])
    return keys


def _indices(keys: KeyPath) -> str:
    """The first index of a path as messages write it, ``[2]``; empty without one."""
    return next((f"[{key}]" for key in keys if isinstance(key, int)), "")
