"""Events: which quantity exceeded its limit, when, how far, and when it recovered. Bounded; pure logic."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from daemon.config.sections.health import Health as Config
from daemon.monitoring.health.hysteresis import Hysteresis
from daemon.monitoring.health.rules import RULES, Level, Rule

log = logging.getLogger("fringed.health")

KEPT = 1000


@dataclass(slots=True)
class Event:
    """One event.

    Args:
        rule: name of the limit; quantity: that exceeded it; t_ns, ended_ns: CLOCK_REALTIME, 0 while it lasts.
        worst: the value farthest beyond; end: ``cleared``, ``unknown``, ``not judged`` (the limit was removed).
    """

    number: int
    rule: str
    quantity: str
    level: Level
    text: str
    limit: float
    worst: float
    t_ns: int
    ended_ns: int = 0
    end: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


class RuleEvaluator:
    """Evaluates every rule once a second and keeps the events.

    Args:
        config: limits and times; may be replaced at any time.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self._states = {rule.name: Hysteresis() for rule in RULES}
        self._open: dict[str, Event] = {}
        self._past: deque[Event] = deque(maxlen=KEPT)
        self._count = 0

    @property
    def open(self) -> list[Event]:
        """The events that last, the most severe first."""
        return sorted(self._open.values(), key=lambda event: (event.level is not Level.ILL, event.number))

    def events(self, most: int = KEPT) -> list[Event]:
        """Return the newest events in the order of their beginning, including those that last."""
        return sorted([*self._past, *self._open.values()], key=lambda event: event.number)[-most:]

    @property
    def count(self) -> int:
        """Number of events since the start."""
        return self._count

    def feed(self, now_s: float, t_ns: int, values: Mapping[str, float], reasons: tuple[str, ...] = ()) -> None:
        """Evaluate the values of this second.

        Args:
            now_s: monotonic; t_ns: CLOCK_REALTIME; reasons: why the daemon is degraded.
        """
        for rule in RULES:
            self._evaluate(rule, now_s, t_ns, values, reasons)

    def verdict(self, rule: Rule, values: Mapping[str, float]) -> str:
        """Return the verdict of one rule: ``ok``, ``warning``, ``ill``, ``unknown`` or ``not judged``."""
        if rule.limit(self.config.limits) is None:
            return "not judged"
        if rule.name in self._open:
            return str(rule.level)
        return "unknown" if math.isnan(rule.worst(values)[1]) else "ok"

    def _evaluate(
        self, rule: Rule, now_s: float, t_ns: int, values: Mapping[str, float], reasons: tuple[str, ...]
    ) -> None:
        limit, (quantity, value) = rule.limit(self.config.limits), rule.worst(values)
        if limit is None:
            self._states[rule.name] = Hysteresis()
            self._end(rule, t_ns, "not judged")
            return
        change = self._states[rule.name].feed(now_s, value, limit, self.config, below=rule.below)
        if change == "raised":
            text = "; ".join(reasons) if rule.name == "degraded" and reasons else rule.text(values, limit)
            self._count += 1
            self._open[rule.name] = Event(self._count, rule.name, quantity, rule.level, text, limit, value, t_ns)
            log.warning("%s: %s", rule.level, text)
        elif change is not None:
            self._end(rule, t_ns, change)
        elif rule.name in self._open and not math.isnan(value):
            event = self._open[rule.name]
            event.worst = min(event.worst, value) if rule.below else max(event.worst, value)

    def _end(self, rule: Rule, t_ns: int, end: str) -> None:
        event = self._open.pop(rule.name, None)
        if event is not None:
            event.ended_ns, event.end = t_ns, end
            self._past.append(event)
            log.info("%s: %s", "recovered" if end == "cleared" else f"over, {end}", event.text)
