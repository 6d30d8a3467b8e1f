"""The table of what is judged: which quantities, against which limit of rig.yaml, and how grave it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from daemon.config.health import HealthLimits
from daemon.monitoring.health.quantities import shown


class Level(StrEnum):
    """How grave an event is: ``warning``, it measures, but not as it should; ``ill``, it does not do its work."""

    WARNING = "warning"
    ILL = "ill"


@dataclass(frozen=True, slots=True)
class Rule:
    """One judgement.

    Args:
        name: of the limit in ``health.limits``; quantities: of which the worst counts, by size.
        below: told when the value falls below the limit, else when it goes beyond.
        words: what is wrong; ``{value}`` and ``{limit}`` are filled in.
    """

    name: str
    quantities: tuple[str, ...]
    level: Level
    words: str
    below: bool = False

    def limit(self, limits: HealthLimits) -> float | None:
        """The limit that holds, None when it is not judged."""
        if self.name == "degraded":
            return 0.5
        value = getattr(limits, self.name)
        if isinstance(value, bool):
            return 0.5 if value else None
        return None if value is None else float(value)

    def worst(self, values: Mapping[str, float]) -> tuple[str, float]:
        """The quantity that is nearest to trouble and its size; NaN when none is known."""
        known = [(abs(values[name]), name) for name in self.quantities if not math.isnan(values.get(name, math.nan))]
        if not known:
            return self.quantities[0], math.nan
        size, name = min(known) if self.below else max(known)
        return name, size

    def text(self, quantity: str, value: float, limit: float) -> str:
        """The event in one sentence."""
        words = self.words.format(value=shown(quantity, value), limit=shown(quantity, limit))
        where = [side for side in ("left", "right") if len(self.quantities) > 1 and side in quantity]
        return f"{words} ({where[0]} camera)" if where else words


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
    Rule("lone_share", ("lone_share",), Level.ILL, "{value} of the frames have no partner, more than {limit}"),
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
        "saturated_share", _sides("saturated_{}"), Level.WARNING, "{value} of a channel is clipped, more than {limit}"
    ),
    Rule(
        "least_modulation",
        _sides("modulation_{}"),
        Level.WARNING,
        "the fringes of a channel have an amplitude of {value}, less than {limit}",
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
