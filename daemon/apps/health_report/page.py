"""The page: verdict, figures, charts and events in one HTML file without external resources."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from daemon.apps.health_report import layout
from daemon.apps.health_report.canvas import Pixels, Svg
from daemon.apps.health_report.panels import HealthHistory
from daemon.common.html_page import Card, figure, page, table
from daemon.monitoring.health.quantities import BY_NAME, format_value

_LEVELS = {"healthy": "good", "warning": "warn", "ill": "bad"}
_CARDS = (
    ("cloud_rate_hz", "clouds per second"),
    ("latency_p99_ms", "latency, 99 %"),
    ("dropped_share", "pairs dropped"),
    ("lone_share", "unpaired frames"),
    ("coverage", "coverage"),
    ("disk_free_gb", "free disk space"),
)


def html(history: HealthHistory) -> bytes:
    """The bytes of the HTML file."""
    report = history.report
    cards = [Card("verdict", report["verdict"], level=_LEVELS.get(report["verdict"], ""))]
    cards += [Card(label, _value(report, name)) for name, label in _CARDS if report["values"].get(name) is not None]
    lines = [f"{_stamp(report['t_ns'])} UTC, up for {layout.duration_text(report['uptime_s'])}, {report['state']}"]
    lines += [event["text"] for event in report["open"]]
    span = layout.duration_text(history.end_s - history.begin_s)
    charts = Svg(*layout.size(history, head=False))
    layout.draw(charts, history, head=False)
    caption = "Lines: mean; bands: minimum to maximum; dashed: limit; shaded: limit exceeded. Times are UTC."
    return page(
        f"Health of {report['device']}",
        lines,
        cards,
        [
            (f"The last {span}", figure(charts.data(), caption)),
            ("Events", _events(history.events)),
            ("Limits", _limits(report)),
            ("Stages over the last minute, ms", _stages(report)),
        ],
    )


def png(history: HealthHistory) -> bytes:
    """The bytes of the PNG file."""
    canvas = Pixels(*layout.size(history))
    layout.draw(canvas, history)
    return canvas.data()


def _value(report: Any, name: str) -> str:
    return format_value(name, report["values"][name])


def _stamp(t_ns: int) -> str:
    return f"{datetime.fromtimestamp(t_ns / 1e9, tz=UTC):%Y-%m-%d %H:%M:%S}"


def _events(events: list[dict[str, Any]]) -> str:
    rows = [
        (_stamp(e["t_ns"]), _stamp(e["ended_ns"]) if e["ended_ns"] else "open", e["level"], e["text"], e["end"])
        for e in reversed(events)
    ]
    open_rows = [n for n, row in enumerate(rows) if row[1] == "open"]
    return (
        table(("start, UTC", "end", "level", "event", "reason"), rows, text=(1, 2, 3, 4), out=open_rows) if rows else ""
    )


def _limits(report: Any) -> str:
    rows = [
        (
            BY_NAME[rule["quantity"]].text,
            "unknown" if rule["value"] is None else format_value(rule["quantity"], rule["value"]),
            f"{'at least' if rule['below'] else 'at most'} {format_value(rule['quantity'], rule['limit'])}",
            rule["verdict"],
        )
        for rule in report["rules"]
        if rule["limit"] is not None and rule["name"] not in ("degraded", "clock_synchronised")
    ]
    beyond = [n for n, row in enumerate(rows) if row[3] in ("warning", "ill")]
    return table(("quantity", "value", "limit", "verdict"), rows, text=(3,), out=beyond)


def _stages(report: Any) -> str:
    stages = report["windows"]["60s"]["stages_ms"]
    names = ("p50", "p95", "p99", "max")
    rows = [(stage, *(f"{spread[name]:.1f}" for name in names)) for stage, spread in stages.items()]
    return table(("stage", *names), rows) if rows else ""
