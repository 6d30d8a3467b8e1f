"""The layout: a head with the verdict, then charts in two columns over the same time."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np

from daemon.apps.health_report.axes import number, ticks, times, value_range
from daemon.apps.health_report.canvas import Canvas, Point
from daemon.apps.health_report.panels import AMBER, GREEN, GREY, RED, Array, Curve, HealthHistory, Panel

INK, GRID = "#1d2733", "#dde3e9"
COLORS = {"healthy": GREEN, "warning": AMBER, "ill": RED, "unknown": GREY}

_WIDTH, _HEAD, _FOOT, _GAP, _PAD = 1120.0, 74.0, 14.0, 34.0, 20.0
_TALL, _COLUMNS, _AXIS = 172.0, 2, 52.0
_TITLE, _CLOCK = 24.0, 20.0  # above and below the plot of a panel


def size(history: HealthHistory, *, head: bool = True) -> tuple[float, float]:
    """(width, height) of the image."""
    rows = math.ceil(max(1, len(history.panels())) / _COLUMNS)
    return _WIDTH + 2 * _PAD, (_HEAD if head else 8.0) + rows * _TALL + _FOOT


def draw(canvas: Canvas, history: HealthHistory, *, head: bool = True) -> None:
    """Draw the whole image; without ``head`` the charts alone."""
    if head:
        _head(canvas, history)
    top = _HEAD if head else 8.0
    wide = (_WIDTH - _GAP) / _COLUMNS
    for index, panel in enumerate(history.panels()):
        row, column = divmod(index, _COLUMNS)
        _Chart(canvas, history, panel, _PAD + column * (wide + _GAP), top + row * _TALL, wide).draw()
    if not history.panels():
        canvas.text(_PAD + _WIDTH / 2, top + _TALL / 2, "no data in this time", 14, GREY, anchor="middle")


def _head(canvas: Canvas, history: HealthHistory) -> None:
    report = history.report
    verdict = report["verdict"]
    canvas.rect(_PAD, 18, 12, 36, COLORS[verdict])
    canvas.text(_PAD + 24, 36, f"{report['device']}: {verdict}", 20, COLORS[verdict], bold=True)
    canvas.text(_PAD + 24, 54, _summary(report), 12, INK)
    day = f"{datetime.fromtimestamp(history.end_s, tz=UTC):%Y-%m-%d %H:%M} UTC"
    canvas.text(_PAD + _WIDTH, 36, day, 13, GREY, anchor="end")
    canvas.text(_PAD + _WIDTH, 54, f"the last {duration_text(history.end_s - history.begin_s)}", 12, GREY, anchor="end")


def _summary(report: Any) -> str:
    texts = [event["text"] for event in report["open"]]
    text = "; ".join(texts[:2]) + (f"; and {len(texts) - 2} more" if len(texts) > 2 else "")
    return (text or "all values are within their limits")[:120]


def duration_text(seconds: float) -> str:
    """Format a duration."""
    if seconds < 120:
        return f"{seconds:.0f} seconds"
    return f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.3g} hours"


class _Chart:
    """One panel at its position."""

    def __init__(self, canvas: Canvas, history: HealthHistory, panel: Panel, x: float, y: float, wide: float) -> None:
        self._canvas, self._history, self._panel = canvas, history, panel
        self._left, self._right = x + _AXIS, x + wide
        self._top, self._bottom = y + _TITLE, y + _TALL - _CLOCK - 10
        self._lines = [(line, history.series[line.quantity]) for line in panel.lines]
        limits = [history.limit(rule) for rule in panel.rules if rule != "degraded"]
        self._limits = [limit * panel.scale for limit in limits if limit is not None]
        self._low, self._high = self._range()

    def draw(self) -> None:
        """Draw the panel."""
        self._frame()
        self._events()
        for line, curve in self._lines:
            for begin, end in runs(curve.mean):
                self._band(curve, line.color, begin, end)
                self._canvas.line(self._points(curve.mean, begin, end), line.color, 1.6)
        for limit in self._limits:
            if self._low <= limit <= self._high:
                ends = [(self._left, self._y(limit)), (self._right, self._y(limit))]
                self._canvas.line(ends, RED, 1.0, dashed=True)
        self._legend()

    def _range(self) -> tuple[float, float]:
        """The range of the values; it includes a limit that is not far beyond them."""
        finite = [part[np.isfinite(part)] for _, curve in self._lines for part in (curve.low, curve.high)]
        values = np.concatenate(finite) * self._panel.scale
        low, high = float(values.min()), float(values.max())
        for limit in self._limits:
            if limit <= 2.5 * max(abs(low), abs(high)):
                low, high = min(low, limit), max(high, limit)
        return value_range(low, high, from_zero=self._panel.from_zero)

    def _x(self, t_s: float) -> float:
        share = (t_s - self._history.begin_s) / (self._history.end_s - self._history.begin_s)
        return self._left + min(1.0, max(0.0, share)) * (self._right - self._left)

    def _y(self, value: float) -> float:
        return self._bottom - (value - self._low) / (self._high - self._low) * (self._bottom - self._top)

    def _frame(self) -> None:
        canvas = self._canvas
        for value in ticks(self._low, self._high):
            canvas.line([(self._left, self._y(value)), (self._right, self._y(value))], GRID, 0.8)
            canvas.text(self._left - 6, self._y(value) + 4, number(value), 11, GREY, anchor="end")
        canvas.line([(self._left, self._bottom), (self._right, self._bottom)], GREY, 0.8)
        for t_s, name in times(self._history.begin_s, self._history.end_s):
            canvas.line([(self._x(t_s), self._bottom), (self._x(t_s), self._bottom + 4)], GREY, 0.8)
            anchor = "end" if self._x(t_s) > self._right - 18 else "middle"
            canvas.text(self._x(t_s), self._bottom + 17, name, 11, GREY, anchor=anchor)  # type: ignore[arg-type]

    def _events(self) -> None:
        """Shade the times at which a limit of this panel was exceeded."""
        for event in self._history.events:
            if event["rule"] not in self._panel.rules:
                continue
            ended_s = event["ended_ns"] / 1e9 or self._history.end_s
            x0, x1 = self._x(event["t_ns"] / 1e9), self._x(ended_s)
            if ended_s > self._history.begin_s and x1 > x0:
                self._canvas.rect(
                    x0, self._top, x1 - x0, self._bottom - self._top, COLORS[event["level"]], opacity=0.12
                )

    def _points(self, values: Array, begin: int, end: int) -> list[Point]:
        t_s = self._history.t_s[begin:end]
        points = [(self._x(t), self._y(v * self._panel.scale)) for t, v in zip(t_s, values[begin:end], strict=True)]
        # A single value is drawn as a short line.
        return points if len(points) > 1 else [(points[0][0] - 1, points[0][1]), (points[0][0] + 1, points[0][1])]

    def _band(self, curve: Curve, color: str, begin: int, end: int) -> None:
        """Shade from the minimum to the maximum."""
        if end - begin > 1:
            outline = self._points(curve.low, begin, end) + self._points(curve.high, begin, end)[::-1]
            self._canvas.area(outline, color, opacity=0.16)

    def _legend(self) -> None:
        canvas, y = self._canvas, self._top - 9
        canvas.text(self._left, y, f"{self._panel.title}, {self._panel.unit}", 13, INK, bold=True)
        x = self._right
        for line, curve in reversed(self._lines):
            if not curve.valid:
                continue
            text = f"{line.label} {_newest(curve, self._panel.scale)}".strip()
            canvas.text(x, y, text, 11.5, line.color, anchor="end", bold=True)
            x -= 6.6 * len(text) + 14


def _newest(curve: Curve, scale: float) -> str:
    value = curve.mean[np.flatnonzero(np.isfinite(curve.mean))[-1]] * scale
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def runs(values: Array) -> list[tuple[int, int]]:
    """Begin and end of every run of valid values."""
    valid = np.concatenate([[False], np.isfinite(values), [False]])
    edges = np.flatnonzero(valid[1:] != valid[:-1])
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
