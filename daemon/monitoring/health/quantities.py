"""The table of monitored quantities, in the order of the history's columns."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.protocols import SIDES

CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number that is evaluated once a second, NaN where unknown.

    Args:
        name: with its unit as suffix where it has one; unit: as displayed; text: description.
    """

    name: str
    unit: str
    text: str


def _light() -> tuple[Quantity, ...]:
    out: list[Quantity] = []
    for side in SIDES:
        out += [Quantity(f"saturated_{side}_{c}", "", f"saturated samples of the {side} camera, {c}") for c in CHANNELS]
        out.append(Quantity(f"saturated_{side}", "", f"the same of its worst channel, {side}"))
    for side in SIDES:
        out += [Quantity(f"modulation_{side}_{c}", "counts", f"fringe amplitude, {side}, {c}") for c in CHANNELS]
        out.append(Quantity(f"modulation_{side}", "counts", f"the same of the weakest channel, {side}"))
    out += [Quantity(f"lit_share_{side}", "", f"pixels with fringes, {side} camera") for side in SIDES]
    return tuple(out)


TABLE: tuple[Quantity, ...] = (
    Quantity("degraded", "", "reasons why the daemon is degraded"),
    Quantity("pair_rate_hz", "Hz", "pairs a second"),
    Quantity("cloud_rate_hz", "Hz", "clouds a second"),
    Quantity("latency_p50_ms", "ms", "start of exposure to finished cloud, median"),
    Quantity("latency_p99_ms", "ms", "start of exposure to finished cloud, 99 % of the clouds"),
    Quantity("arrival_p99_ms", "ms", "arrival of both frames to finished cloud, 99 % of the clouds"),
    Quantity("dropped_share", "", "pairs dropped unmeasured"),
    Quantity("lone_share", "", "unpaired frames"),
    Quantity("refused_hz", "Hz", "items refused by recorder, stream or self-check"),
    Quantity("pairing_residual_us", "µs", "right minus left start of exposure, median"),
    Quantity("pairing_spread_us", "µs", "largest deviation from that median"),
    Quantity("trigger_interval_ms", "ms", "interval of the triggers, median"),
    Quantity("trigger_jitter_us", "µs", "standard deviation of that interval"),
    *_light(),
    Quantity("coverage", "", "pixels with a point, newest cloud"),
    Quantity("coverage_lit", "", "pixels with a point where there are fringes"),
    *(Quantity(f"temperature_{side}_c", "°C", f"temperature of the {side} camera") for side in SIDES),
    Quantity("disk_free_gb", "GB", "free space where takes are written"),
    Quantity("clock_offset_ms", "ms", "the clock against its time servers"),
    Quantity("clock_unsynchronised", "", "1 while the clock is not synchronised"),
    Quantity("calibration_age_d", "days", "age of the calibration"),
    Quantity("memory_mb", "MB", "memory of the daemon"),
)

BY_NAME = {quantity.name: quantity for quantity in TABLE}
NAMES = tuple(BY_NAME)


def format_value(name: str, value: float) -> str:
    """Format a value with its unit."""
    unit = BY_NAME[name].unit
    if not unit and ("share" in name or name.startswith(("saturated", "coverage"))):
        return f"{100 * value:.3g} %"
    number = f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return f"{number} {unit}".rstrip()
