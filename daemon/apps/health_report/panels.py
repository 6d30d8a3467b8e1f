"""The panels of a report and their curves, requested from a daemon."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.control.health_methods import MOST_SERIES

Array = NDArray[np.float64]

BLUE, RED, GREEN, AMBER, PURPLE, GREY = "#1668b0", "#c8372d", "#1d7d4a", "#d98a00", "#6a3fa0", "#66727f"


@dataclass(frozen=True, slots=True)
class Line:
    """A curve of a panel: its quantity, label and colour."""

    quantity: str
    label: str
    color: str


@dataclass(frozen=True, slots=True)
class Panel:
    """One chart.

    Args:
        title: above the chart; unit: of its axis; rules: with drawn limits; scale: from the quantity to the axis.
        from_zero: whether the axis shows zero.
    """

    title: str
    unit: str
    lines: tuple[Line, ...]
    rules: tuple[str, ...] = ()
    scale: float = 1.0
    from_zero: bool = True


def _channels(kind: str, side: str) -> tuple[Line, ...]:
    colors = (("red", RED), ("green", GREEN), ("blue", BLUE))
    return tuple(Line(f"{kind}_{side}_{channel}", channel, color) for channel, color in colors)


def _sides(name: str) -> tuple[Line, Line]:
    return Line(name.format("left"), "left", BLUE), Line(name.format("right"), "right", AMBER)


PANELS: tuple[Panel, ...] = (
    Panel(
        "Rate",
        "Hz",
        (Line("pair_rate_hz", "pairs", AMBER), Line("cloud_rate_hz", "clouds", BLUE)),
        ("degraded", "least_pair_rate_hz", "least_cloud_rate_hz"),
    ),
    Panel(
        "Latency",
        "ms",
        (Line("latency_p99_ms", "99 %", RED), Line("latency_p50_ms", "median", BLUE)),
        ("latency_p99_ms",),
    ),
    Panel(
        "Losses",
        "%",
        (Line("dropped_share", "pairs dropped", RED), Line("lone_share", "unpaired frames", AMBER)),
        ("dropped_share", "lone_share"),
        scale=100,
    ),
    Panel(
        "Coverage",
        "%",
        (Line("coverage_lit", "lit pixels", AMBER), Line("coverage", "all pixels", BLUE)),
        ("least_coverage", "least_lit_coverage"),
        scale=100,
    ),
    Panel("Pixels with fringes", "%", _sides("lit_share_{}"), ("least_lit_share",), scale=100),
    Panel("Modulation, left", "counts", _channels("modulation", "left"), ("least_modulation",)),
    Panel("Modulation, right", "counts", _channels("modulation", "right"), ("least_modulation",)),
    Panel("Saturated samples, left", "%", _channels("saturated", "left"), ("saturated_share",), scale=100),
    Panel("Saturated samples, right", "%", _channels("saturated", "right"), ("saturated_share",), scale=100),
    Panel(
        "Right minus left exposure",
        "µs",
        (Line("pairing_residual_us", "median", BLUE), Line("pairing_spread_us", "largest deviation", AMBER)),
        ("pairing_residual_us",),
    ),
    Panel("Trigger jitter", "µs", (Line("trigger_jitter_us", "", BLUE),), ("trigger_jitter_us",)),
    Panel("Camera temperature", "°C", _sides("temperature_{}_c"), ("temperature_c",), from_zero=False),
    Panel("Free disk space", "GB", (Line("disk_free_gb", "", BLUE),), ("least_disk_free_gb",)),
    Panel("Clock offset", "ms", (Line("clock_offset_ms", "", BLUE),), ("clock_offset_ms",)),
    Panel("Memory", "MB", (Line("memory_mb", "", BLUE),), ("memory_mb",)),
)


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One quantity over time, (n,) each; NaN where it is missing."""

    mean: Array
    low: Array
    high: Array

    @property
    def valid(self) -> bool:
        """Whether any value is valid."""
        return bool(np.isfinite(self.mean).any())


@dataclass(frozen=True, slots=True, eq=False)
class HealthHistory:
    """The data of a report.

    Args:
        t_s: (n,) middles of the intervals, seconds since 1970; period_s: their length.
        report: answer of ``health``; events: of ``health.events``.
    """

    t_s: Array
    period_s: float
    series: Mapping[str, Curve]
    report: Mapping[str, Any]
    events: list[dict[str, Any]] = field(default_factory=list)

    @property
    def begin_s(self) -> float:
        """Left border of the image."""
        return float(self.t_s[0] - self.period_s / 2)

    @property
    def end_s(self) -> float:
        """Right border of the image."""
        return float(self.t_s[-1] + self.period_s / 2)

    def limit(self, rule: str) -> float | None:
        """The limit of a rule, None without one."""
        limits = [entry["limit"] for entry in self.report["rules"] if entry["name"] == rule]
        return float(limits[0]) if limits and limits[0] is not None else None

    def panels(self) -> list[Panel]:
        """The panels with data."""
        return [panel for panel in PANELS if any(self.series[line.quantity].valid for line in panel.lines)]


def request_history(call: Callable[..., Any], seconds: float, points: int = 300) -> HealthHistory:
    """Request the data from a daemon; ``call`` is the method of its control client."""
    names = list(dict.fromkeys(line.quantity for panel in PANELS for line in panel.lines))
    series: dict[str, Curve] = {}
    answer: dict[str, Any] = {}
    for at in range(0, len(names), MOST_SERIES):
        answer = call("health.history", quantities=names[at : at + MOST_SERIES], seconds=seconds, points=points)
        series |= {name: _curve(parts) for name, parts in answer["series"].items()}
    shortest = min(len(curve.mean) for curve in series.values())
    t_s = np.array(answer["t_s"][-shortest:], dtype=np.float64)
    return HealthHistory(t_s, float(answer["period_s"]), series, call("health"), call("health.events", most=500))


def _curve(parts: Mapping[str, list[float | None]]) -> Curve:
    return Curve(*(np.array(parts[part], dtype=np.float64) for part in ("mean", "low", "high")))
