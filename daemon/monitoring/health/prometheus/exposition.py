"""The report as Prometheus reads it: text exposition format 0.0.4."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from daemon.monitoring.health.quantities import BY_NAME

VERDICTS = ("healthy", "warning", "ill", "unknown")
_QUANTILES = {"p50": "0.5", "p95": "0.95", "p99": "0.99"}
_WINDOW = "60s"


def exposition(report: Mapping[str, Any]) -> str:
    """All metrics; unknown values are left out, as Prometheus expects."""
    return "".join(f"{line}\n" for line in _lines(report))


def _lines(report: Mapping[str, Any]) -> Iterator[str]:
    yield from _family("health", "gauge", "1 for the verdict that holds", (
        ({"verdict": verdict}, float(report["verdict"] == verdict)) for verdict in VERDICTS
    ))  # fmt: skip
    judged = [rule for rule in report["rules"] if rule["limit"] is not None]
    yield from _family("rule_open", "gauge", "1 while a limit is exceeded", (
        ({"rule": rule["name"]}, float(rule["verdict"] in ("warning", "ill"))) for rule in judged
    ))  # fmt: skip
    for name, value in report["values"].items():
        if value is not None:
            unit = f", {BY_NAME[name].unit}" if BY_NAME[name].unit else ""
            yield from _family(name, "gauge", f"{BY_NAME[name].text}{unit}", [({}, value)])
    yield from _totals(report["totals"])
    stages = report["windows"][_WINDOW]["stages_ms"]
    yield from _family("stage_ms", "gauge", "time of each stage, over a minute, ms", (
        ({"stage": stage, "quantile": quantile}, spread[p])
        for stage, spread in stages.items()
        for p, quantile in _QUANTILES.items()
    ))  # fmt: skip
    yield from _family("uptime_s", "gauge", "seconds since the daemon began", [({}, float(report["uptime_s"]))])


def _totals(totals: Mapping[str, Any]) -> Iterator[str]:
    for what in ("pairs", "clouds"):
        yield from _family(f"{what}_total", "counter", f"{what} since the start", [({}, float(totals[what]))])
    drops = (({"reason": reason}, float(count)) for reason, count in totals["drops"].items())
    yield from _family("drops_total", "counter", "what was dropped, by reason", drops)
    fates = (
        ({"camera": side, "fate": outcome}, float(count))
        for side, counts in totals["fates"].items()
        for outcome, count in counts.items()
        if outcome != "waiting"
    )
    yield from _family("frames_total", "counter", "what became of the frames", fates)


def _family(name: str, kind: str, text: str, samples: Any) -> Iterator[str]:
    rows = list(samples)
    if not rows:
        return
    yield f"# HELP fringed_{name} {text}"
    yield f"# TYPE fringed_{name} {kind}"
    for labels, value in rows:
        inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        yield f"fringed_{name}{{{inside}}} {value:.9g}" if inside else f"fringed_{name} {value:.9g}"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
