"""Checks of a request's parameters; a wrong one raises RpcError with the parameter's name as its path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daemon.control.rpc.protocol import INVALID_PARAMS, RpcError


def number(
    params: Mapping[str, Any], key: str, default: float, least: float, most: float, *, whole: bool = False
) -> float:
    """Return a number between two limits, a whole one if ``whole``."""
    value = params.get(key, default)
    kind = int if whole else int | float
    if isinstance(value, bool) or not isinstance(value, kind) or not least <= value <= most:
        what = "a whole number" if whole else "a number"
        raise RpcError(INVALID_PARAMS, f"{key} is {value!r:.60}, expected {what} from {least:g} to {most:g}", key)
    return float(value)


def string(params: Mapping[str, Any], key: str, default: str | None = None) -> str:
    """Return a string."""
    value = params.get(key, default)
    if not isinstance(value, str):
        raise RpcError(INVALID_PARAMS, f"the parameter {key} must be a string", key)
    return value
