"""The report as text for a terminal, at most 80 columns wide."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from daemon.monitoring.health.quantities import format_value

WIDTH = 80
_EVENTS = 8
_SPREAD = ("p50", "p95", "p99", "max")


def report_text(report: Mapping[str, Any], events: list[dict[str, Any]]) -> str:
    """Format verdict, limits, windows, drops and events."""
    return "\n".join(line[:WIDTH].rstrip() for line in _lines(report, events))


def _lines(report: Mapping[str, Any], events: list[dict[str, Any]]) -> Iterator[str]:
    yield f"{report['verdict'].upper()}   {report['device']}, {report['state']}, up {report['uptime_s']:.0f} s"
    for event in report["open"]:
        yield from _wrapped(f"{event['level']}: {event['text']} (since {_clock(event['t_ns'])})")
    yield ""
    yield f"{'quantity':<24}{'value':>14}{'limit':>16}   verdict"
    for rule in report["rules"]:
        if rule["limit"] is not None:
            yield _rule(rule)
    yield ""
    yield from _windows(report["windows"])
    drops = report["totals"]["drops"]
    yield from _wrapped("dropped: " + (", ".join(f"{name} {count}" for name, count in drops.items()) or "nothing"))
    yield from _wrapped(f"clock: {clock_text(report['clock'])}")
    if events:
        yield ""
        yield "events, UTC"
        for event in events[-_EVENTS:]:
            ended = f"{event['end']} {_clock(event['ended_ns'])}" if event["ended_ns"] else "open"
            yield from _wrapped(f"{_clock(event['t_ns'])}  {event['level']}: {event['text']}; {ended}")


def _rule(rule: Mapping[str, Any]) -> str:
    if rule["name"] in ("degraded", "clock_synchronised"):
        answers = {"ok": "yes" if rule["name"] != "degraded" else "no", "unknown": "unknown"}
        now = answers.get(rule["verdict"], "no" if rule["name"] != "degraded" else "yes")
        return f"{rule['name']:<24}{now:>14}{'':>16}   {rule['verdict']}"
    now = "unknown" if rule["value"] is None else format_value(rule["quantity"], rule["value"])
    limit = f"{'>=' if rule['below'] else '<='} {format_value(rule['quantity'], rule['limit'])}"
    return f"{rule['name']:<24}{now:>14}{limit:>16}   {rule['verdict']}"


def _windows(windows: Mapping[str, Any]) -> Iterator[str]:
    for name, window in windows.items():
        head = "".join(f"{p:>8}" for p in _SPREAD)
        yield f"{'last ' + name:<22}{head}   {window['clouds']} clouds, {window['pairs']} pairs"
        rows = {"latency": window["latency_ms"], **window["stages_ms"]}
        for row, spread in rows.items():
            if spread:
                yield f"  {row + ', ms':<20}" + "".join(f"{spread[p]:>8.1f}" for p in _SPREAD)
        yield ""


def clock_text(clock: Mapping[str, Any]) -> str:
    """Format the state of the clock."""
    if clock["synchronised"] is None:
        return "synchronisation unknown"
    off = "" if clock["offset_ms"] is None else f", {clock['offset_ms']:.3g} ms offset"
    return f"{'synchronised' if clock['synchronised'] else 'not synchronised'} ({clock['source']}{off})"


def _clock(t_ns: int) -> str:
    return f"{datetime.fromtimestamp(t_ns / 1e9, tz=UTC):%H:%M:%S}"


def _wrapped(line: str) -> list[str]:
    return textwrap.wrap(line, WIDTH, subsequent_indent="  ") or [""]
