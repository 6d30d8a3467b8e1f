"""The report as Prometheus metrics, in text exposition format 0.0.4."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from prometheus_client import generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from daemon.monitoring.health.quantities import BY_NAME

VERDICTS = ("healthy", "warning", "ill", "unknown")
_QUANTILES = {"p50": "0.5", "p95": "0.95", "p99": "0.99"}
_WINDOW = "60s"

_Family = GaugeMetricFamily | CounterMetricFamily
_Samples = Iterable[tuple[Sequence[str], float]]


def exposition(report: Mapping[str, Any]) -> str:
    """Return all metrics of a report; unknown quantities and families without a sample are left out."""
    return generate_latest(_Metrics(report)).decode()


class _Metrics(Collector):
    def __init__(self, report: Mapping[str, Any]) -> None:
        self._report = report

    def collect(self) -> Iterator[_Family]:
        return (family for family in _families(self._report) if family.samples)


def _families(report: Mapping[str, Any]) -> Iterator[_Family]:
    verdicts = (([verdict], float(report["verdict"] == verdict)) for verdict in VERDICTS)
    yield _gauge("health", "1 for the present verdict", verdicts, "verdict")
    rules = ((rule["name"], rule["verdict"]) for rule in report["rules"] if rule["limit"] is not None)
    is_open = (([name], float(verdict in ("warning", "ill"))) for name, verdict in rules)
    yield _gauge("rule_open", "1 while a limit is exceeded", is_open, "rule")
    for name, value in report["values"].items():
        if value is not None:
            unit = f", {BY_NAME[name].unit}" if BY_NAME[name].unit else ""
            yield _gauge(name, f"{BY_NAME[name].text}{unit}", [([], value)])
    yield from _totals(report["totals"])
    stages = (
        ([stage, quantile], spread[p])
        for stage, spread in report["windows"][_WINDOW]["stages_ms"].items()
        for p, quantile in _QUANTILES.items()
    )
    yield _gauge("stage_ms", "time of each stage, over a minute, ms", stages, "stage", "quantile")
    yield _gauge("uptime_s", "seconds since the daemon started", [([], float(report["uptime_s"]))])


def _totals(totals: Mapping[str, Any]) -> Iterator[_Family]:
    for name in ("pairs", "clouds"):
        yield _counter(name, f"{name} since the start", [([], float(totals[name]))])
    drops = (([reason], float(count)) for reason, count in totals["drops"].items())
    yield _counter("drops", "drops by reason", drops, "reason")
    outcomes = (
        ([side, outcome], float(count))
        for side, counts in totals["fates"].items()
        for outcome, count in counts.items()
        if outcome != "waiting"
    )
    yield _counter("frames", "frames by camera and outcome", outcomes, "camera", "fate")


def _gauge(name: str, text: str, samples: _Samples, *labels: str) -> _Family:
    return _filled(GaugeMetricFamily(f"fringed_{name}", text, labels=labels), samples)


def _counter(name: str, text: str, samples: _Samples, *labels: str) -> _Family:
    """A counter; the library appends ``_total`` to its name."""
    return _filled(CounterMetricFamily(f"fringed_{name}", text, labels=labels), samples)


def _filled(family: _Family, samples: _Samples) -> _Family:
    for labels, value in samples:
        family.add_metric(labels, value)
    return family
