"""``--set key=value`` on the command line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.common.settings import Settings


def parsed_settings(texts: list[str], preset: Mapping[str, Any] | None = None) -> Settings:
    """The pipeline's settings, those of a preset, changed by ``key=value`` texts.

    Raises:
        InputError: a text of another form; PipelineError: an unknown key or invalid value.
    """
    from daemon.common.errors import InputError
    from pipeline.common.settings import Settings

    changes: dict[str, object] = {}
    for text in texts:
        key, _, value = text.partition("=")
        try:
            changes[key.strip()] = json.loads(value)
        except ValueError as error:
            if key.strip() == "preset":
                raise InputError(f"--set {text}: a preset is no setting, see fringed preset list") from error
            raise InputError(f"--set {text}: expected key=value with a number, true or false") from error
    return Settings().with_overrides((preset or {}).get("settings", {})).with_overrides(changes)


def parsed_values(texts: list[str]) -> dict[str, list[object]]:
    """The values to compare of each setting, from texts ``key=value,value``; InputError for another form."""
    from daemon.common.errors import InputError

    values: dict[str, list[object]] = {}
    for text in texts:
        key, _, several = text.partition("=")
        try:
            values[key.strip()] = [json.loads(value) for value in several.split(",")]
        except ValueError as error:
            raise InputError(f"--set {text}: expected key=value,value with numbers, true or false") from error
    return values
