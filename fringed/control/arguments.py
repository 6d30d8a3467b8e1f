"""Checks of arguments that every part of the client takes."""

from __future__ import annotations

import math

from fringed.errors import ArgumentError

LONGEST_S = 1e6


def checked_timeout(timeout_s: object, *, name: str = "timeout_s") -> float:
    """Return a time-out in seconds.

    Raises:
        ArgumentError: not a number, or not from 0 to a million.
    """
    if isinstance(timeout_s, bool) or not isinstance(timeout_s, int | float) or not 0 < timeout_s <= LONGEST_S:
        shown = "NaN" if isinstance(timeout_s, float) and math.isnan(timeout_s) else repr(timeout_s)[:60]
        raise ArgumentError(f"{name} is {shown}, expected seconds, more than 0 and at most {LONGEST_S:g}")
    return float(timeout_s)


def checked_timeout_or_none(timeout_s: object, *, name: str = "timeout_s") -> float | None:
    """Return a time-out in seconds, or None for no limit; ArgumentError for anything else."""
    return None if timeout_s is None else checked_timeout(timeout_s, name=name)
