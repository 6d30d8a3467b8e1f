"""Round values for the axes of numbers and of time."""

from __future__ import annotations

import math
from datetime import UTC, datetime, tzinfo

_STEPS_S = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400)


def value_range(low: float, high: float, *, from_zero: bool) -> tuple[float, float]:
    """The range of an axis, slightly larger than that of the values; never empty."""
    if from_zero:
        low, high = min(0.0, low), max(0.0, high)
    if high - low < 1e-9 * max(1.0, abs(high)):
        return (low, low + 1.0) if from_zero else (low - 1.0, low + 1.0)
    margin = 0.08 * (high - low)
    return low - (0.0 if from_zero and low == 0 else margin), high + (0.0 if from_zero and high == 0 else margin)


def ticks(low: float, high: float, most: int = 4) -> list[float]:
    """Round values inside a range, at most ``most`` + 1."""
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = power * min(n for n in (1, 2, 2.5, 5, 10) if n * power >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [n * step for n in range(first, math.floor(high / step + 1e-9) + 1)]


def number(value: float) -> str:
    """Format a value of an axis."""
    return f"{value / 1000:g}k" if abs(value) >= 10_000 else f"{round(value, 6):g}"


def times(begin_s: float, end_s: float, most: int = 6, zone: tzinfo | None = UTC) -> list[tuple[float, str]]:
    """Round times of day inside an interval, with their labels."""
    step = next((s for s in _STEPS_S if (end_s - begin_s) / s <= most), _STEPS_S[-1])
    first = math.ceil(begin_s / step) * step
    time_format = "%H:%M:%S" if step < 60 else "%H:%M"
    return [
        (t, f"{datetime.fromtimestamp(t, tz=zone):{time_format}}") for t in range(first, math.floor(end_s) + 1, step)
    ]
