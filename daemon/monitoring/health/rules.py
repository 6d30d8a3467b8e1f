"""The table of rules: which quantities are compared with which limit of rig.yaml, and the level of an event."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from daemon.config.sections.health import HealthLimits
from daemon.monitoring.health.quantities import format_value


class Level(StrEnum):
    """Level of an event: ``warning``, measuring is impaired; ``ill``, the daemon does not fulfil its task."""

    WARNING = "warning"
    ILL = "ill"


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule.

    Args:
        name: of the limit in ``health.limits``; quantities: of which the worst counts, by size.
        below: raised when the value falls below the limit, else when it exceeds it.
        template: message of the event, with ``{value}`` and ``{limit}``.
    """

    name: str
    quantities: tuple[str, ...]
    level: Level
    template: str
    below: bool = False

    def limit(self, limits: HealthLimits) -> float | None:
        """Return the limit, None where the rule is disabled."""
        if self.name == "degraded":
            return 0.5
        value = getattr(limits, self.name)
        if isinstance(value, bool):
            return 0.5 if value else None
        return None if value is None else float(value)

    def worst(self, values: Mapping[str, float]) -> tuple[str, float]:
        """Return the quantity nearest to its limit and its size; NaN when none is known."""
        known = [(abs(values[name]), name) for name in self.quantities if not math.isnan(values.get(name, math.nan))]
        if not known:
            return self.quantities[0], math.nan
        size, name = min(known) if self.below else max(known)
        return name, size

    def text(self, values: Mapping[str, float], limit: float) -> str:
        """Return the event's message; it names the cameras that break the limit."""
        quantity, worst = self.worst(values)
        text = self.template.format(value=format_value(quantity, worst), limit=format_value(quantity, limit))
        breaking = [name for name in self.quantities if self._breaks(abs(values.get(name, math.nan)), limit)]
        cameras = [side for side in ("left", "right") if any(side in name for name in breaking)]
        if len(self.quantities) == 1 or not cameras:
            return text
        return f"{text} ({' and '.join(cameras)} camera{'s' * (len(cameras) > 1)})"

    def _breaks(self, size: float, limit: float) -> bool:
        return size < limit if self.below else size > limit


def _sides(name: str) -> tuple[str, ...]:
    return tuple(name.format(side) for side in ("left", "right"))


RULES: tuple[Rule, ...] = (
    Rule("degraded", ("degraded",), Level.ILL, "the daemon is degraded"),
    Rule("least_pair_rate_hz", ("pair_rate_hz",), Level.ILL, "{value} pairs a second, less than {limit}", below=True),
    Rule(
        "least_cloud_rate_hz", ("cloud_rate_hz",), Level.ILL, "{value} clouds a second, less than {limit}", below=True
    ),
    Rule("latency_p99_ms", ("latency_p99_ms",), Level.ILL, "latency {value}, more than {limit}"),
    Rule("dropped_share", ("dropped_share",), Level.ILL, "{value} of the pairs are dropped, more than {limit}"),
    Rule("lone_share", ("lone_share",), Level.ILL, "{value} of the frames are unpaired, more than {limit}"),
    Rule("refused_hz", ("refused_hz",), Level.ILL, "{value} items are refused by a full recorder or stream"),
    Rule(
        "pairing_residual_us",
        ("pairing_residual_us",),
        Level.WARNING,
        "the exposures of a pair begin {value} apart, more than {limit}",
    ),
    Rule(
        "trigger_jitter_us",
        ("trigger_jitter_us",),
        Level.WARNING,
        "the trigger interval scatters by {value}, more than {limit}",
    ),
    Rule(
        "saturated_share", _sides("saturated_{}"), Level.WARNING, "{value} of a channel is saturated, more than {limit}"
    ),
    Rule(
        "least_modulation",
        _sides("modulation_{}"),
        Level.WARNING,
        "the fringes of a channel have an amplitude of {value}, less than {limit}",
        below=True,
    ),
    Rule(
        "least_lit_share",
        _sides("lit_share_{}"),
        Level.ILL,
        "no fringes ({value} of the image): projector, lens cap, exposure",
        below=True,
    ),
    Rule(
        "least_lit_coverage",
        ("coverage_lit",),
        Level.ILL,
        "{value} of the lit pixels have a point: projected image, volume, calibration",
        below=True,
    ),
    Rule(
        "least_coverage", ("coverage",), Level.ILL, "{value} of the pixels have a point, less than {limit}", below=True
    ),
    Rule("temperature_c", _sides("temperature_{}_c"), Level.WARNING, "{value}, more than {limit}"),
    Rule(
        "least_disk_free_gb", ("disk_free_gb",), Level.WARNING, "{value} free for takes, less than {limit}", below=True
    ),
    Rule("clock_offset_ms", ("clock_offset_ms",), Level.WARNING, "the clock is {value} off, more than {limit}"),
    Rule("clock_synchronised", ("clock_unsynchronised",), Level.WARNING, "the clock is not synchronised"),
    Rule(
        "calibration_age_d", ("calibration_age_d",), Level.WARNING, "the calibration is {value} old, more than {limit}"
    ),
    Rule("memory_mb", ("memory_mb",), Level.WARNING, "the daemon holds {value} of memory, more than {limit}"),
)
