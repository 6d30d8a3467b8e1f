"""Evaluation once a second: all quantities, a row of the history, and the rules. No threads of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from daemon.config.sections.health import Health as Config
from daemon.monitoring.health.events import RuleEvaluator
from daemon.monitoring.health.history import History
from daemon.monitoring.health.observe.clock_sync import ClockSync
from daemon.monitoring.health.observe.counter_rates import CounterRates
from daemon.monitoring.health.observe.frame_statistics import FrameStatistics
from daemon.monitoring.health.quantities import NAMES
from daemon.monitoring.health.rules import RULES, Level

_IDLE = ("starting", "paused", "stopping")
_SECONDS_KNOWN = 5.0
_WINDOWS = (10.0, 60.0)


class Monitor:
    """The health of the daemon: quantities, history and events."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.frames, self.history = FrameStatistics(), History(len(NAMES), config.history_h)
        self.rules = RuleEvaluator(config)
        self._rates = CounterRates()
        self._illumination: tuple[float, dict[str, float]] = (-math.inf, {})
        self.values: dict[str, float] = dict.fromkeys(NAMES, math.nan)
        self.status: Mapping[str, Any] = {}
        self.clock = ClockSync()
        self._was_idle = True

    def configure(self, config: Config) -> None:
        """Use other limits and times from the next second on; open events stay until they clear."""
        self.config = self.rules.config = config

    def set_illumination(self, now_s: float, values: dict[str, float]) -> None:
        """Take the illumination of one pair."""
        self._illumination = (now_s, values)

    def second(
        self, now_ns: int, status: Mapping[str, Any], machine: Mapping[str, float], clock: ClockSync | None
    ) -> None:
        """Evaluate the status of this second.

        Args:
            now_ns: monotonic; machine: quantities of disk, memory and calibration; clock: None if unknown.
        """
        now_s = now_ns / 1e9
        self.status, self.clock = status, clock or ClockSync()
        idle = status["state"] in _IDLE
        if idle and not self._was_idle:
            self.frames.clear()
        self._was_idle = idle
        self._rates.add(now_s, status)
        values = dict.fromkeys(NAMES, math.nan) | dict(machine) | _clock(self.clock) | _temperatures(status)
        if not idle:
            values |= self._flow(now_ns, status)
        self.values = values
        self.history.add(now_s, np.array([values[name] for name in NAMES], np.float32))
        self.rules.feed(now_s, int(status["t_ns"]), values, tuple(status["reasons"]))

    def _flow(self, now_ns: int, status: Mapping[str, Any]) -> dict[str, float]:
        now_s, window_s = now_ns / 1e9, float(self.config.window_s)
        out = {
            "degraded": float(len(status["reasons"])),
            "pair_rate_hz": float(status["pair_rate_hz"]),
            "cloud_rate_hz": float(status["cloud_rate_hz"]),
        }
        out |= self._rates.values(now_s, window_s) | self.frames.values(now_ns, window_s)
        if status["cloud_rate_hz"] > 0:
            out["coverage"] = float(status["valid"])
        if now_s - self._illumination[0] < _SECONDS_KNOWN:
            out |= self._illumination[1]
        return out

    @property
    def verdict(self) -> str:
        """``ill``, ``warning``, ``unknown`` (there is no cloud to evaluate) or ``healthy``."""
        levels = {event.level for event in self.rules.open}
        if levels:
            return str(Level.ILL if Level.ILL in levels else Level.WARNING)
        return "unknown" if math.isnan(self.values["latency_p99_ms"]) else "healthy"

    def short(self) -> dict[str, Any]:
        """Return a summary for the status, which is bounded in size."""
        opened = self.rules.open
        return {
            "verdict": self.verdict,
            "open": {event.rule: event.text[:80] for event in opened[:4]},
            "open_count": len(opened),
            "events": self.rules.count,
        }

    def report(self, now_ns: int) -> dict[str, Any]:
        """Return the whole report as plain values, None where unknown."""
        status, values = self.status, self.values
        return {
            "verdict": self.verdict,
            "state": str(status.get("state", "")),
            "device": status.get("device", ""),
            "t_ns": status.get("t_ns", 0),
            "uptime_s": status.get("uptime_s", 0.0),
            "open": [event.as_dict() for event in self.rules.open],
            "values": {name: number_or_none(value) for name, value in values.items()},
            "rules": [self._rule(rule) for rule in RULES],
            "windows": {f"{s:.0f}s": self._window(now_ns, s) for s in _WINDOWS},
            "totals": {
                "pairs": status.get("pairs", 0),
                "clouds": status.get("clouds", 0),
                "drops": dict(status.get("drops", {})),
                "fates": {side: dict(camera["fates"]) for side, camera in status.get("cameras", {}).items()},
            },
            "clock": {
                "source": self.clock.source,
                "synchronised": self.clock.synchronised,
                "offset_ms": self.clock.offset_ms,
            },
            "history": dict(zip(("seconds", "minutes"), self.history.rows, strict=True))
            | {"bytes": self.history.nbytes},
        }

    def _rule(self, rule: Any) -> dict[str, Any]:
        quantity, value = rule.worst(self.values)
        return {
            "name": rule.name,
            "quantity": quantity,
            "verdict": self.rules.verdict(rule, self.values),
            "value": number_or_none(value),
            "limit": rule.limit(self.config.limits),
            "below": rule.below,
        }

    def _window(self, now_ns: int, seconds: float) -> dict[str, Any]:
        return self.frames.window(now_ns, seconds) | {"drops_hz": self._rates.drops(now_ns / 1e9, seconds)}


def number_or_none(value: float) -> float | None:
    """Return a number for JSON, None where it is unknown."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _clock(clock: ClockSync) -> dict[str, float]:
    out = {} if clock.offset_ms is None else {"clock_offset_ms": clock.offset_ms}
    return out | ({} if clock.synchronised is None else {"clock_unsynchronised": float(not clock.synchronised)})


def _temperatures(status: Mapping[str, Any]) -> dict[str, float]:
    values = {side: camera["temperature_c"] for side, camera in status["cameras"].items()}
    return {f"temperature_{side}_c": float(value) for side, value in values.items() if value is not None}
