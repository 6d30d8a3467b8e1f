"""Where everything stands: a head with the verdict, then charts in two columns over the same time."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np

from daemon.apps.health_report.axes import number, ticks, times, value_range
from daemon.apps.health_report.canvas import Canvas, Point
from daemon.apps.health_report.panels import AMBER, GREEN, GREY, RED, Array, Course, Courses, Panel

INK, GRID = "#1d2733", "#dde3e9"
COLORS = {"healthy": GREEN, "warning": AMBER, "ill": RED, "unknown": GREY}

_WIDTH, _HEAD, _FOOT, _GAP, _PAD = 1120.0, 74.0, 14.0, 34.0, 20.0
_TALL, _COLUMNS, _AXIS = 172.0, 2, 52.0
_TITLE, _CLOCK = 24.0, 20.0  # above and below the plot of a panel


def size(courses: Courses, *, head: bool = True) -> tuple[float, float]:
    """(width, height) of the image."""
    rows = math.ceil(max(1, len(courses.panels())) / _COLUMNS)
    return _WIDTH + 2 * _PAD, (_HEAD if head else 8.0) + rows * _TALL + _FOOT


def draw(canvas: Canvas, courses: Courses, *, head: bool = True) -> None:
    """The whole image; without ``head`` the charts alone."""
    if head:
        _head(canvas, courses)
    top = _HEAD if head else 8.0
    wide = (_WIDTH - _GAP) / _COLUMNS
    for place, panel in enumerate(courses.panels()):
        row, column = divmod(place, _COLUMNS)
        _Chart(canvas, courses, panel, _PAD + column * (wide + _GAP), top + row * _TALL, wide).draw()
    if not courses.panels():
        canvas.text(_PAD + _WIDTH / 2, top + _TALL / 2, "nothing is known of this time", 14, GREY, anchor="middle")


def _head(canvas: Canvas, courses: Courses) -> None:
    report = courses.report
    verdict = report["verdict"]
    canvas.rect(_PAD, 18, 12, 36, COLORS[verdict])
    canvas.text(_PAD + 24, 36, f"{report['device']}: {verdict}", 20, COLORS[verdict], bold=True)
    canvas.text(_PAD + 24, 54, _what(report), 12, INK)
    day = f"{datetime.fromtimestamp(courses.end_s, tz=UTC):%Y-%m-%d %H:%M} UTC"
    canvas.text(_PAD + _WIDTH, 36, day, 13, GREY, anchor="end")
    canvas.text(_PAD + _WIDTH, 54, f"the last {span_words(courses.end_s - courses.begin_s)}", 12, GREY, anchor="end")


def _what(report: Any) -> str:
    texts = [event["text"] for event in report["open"]]
    told = "; ".join(texts[:2]) + (f"; and {len(texts) - 2} more" if len(texts) > 2 else "")
    return (told or "nothing is beyond its limit")[:120]


def span_words(seconds: float) -> str:
    """A stretch of time in words."""
    if seconds < 120:
        return f"{seconds:.0f} seconds"
    return f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.3g} hours"


class _Chart:
    """One panel at its place."""

    def __init__(self, canvas: Canvas, courses: Courses, panel: Panel, x: float, y: float, wide: float) -> None:
        self._canvas, self._courses, self._panel = canvas, courses, panel
        self._left, self._right = x + _AXIS, x + wide
        self._top, self._bottom = y + _TITLE, y + _TALL - _CLOCK - 10
        self._lines = [(line, courses.series[line.quantity]) for line in panel.lines]
        judged = [courses.limit(rule) for rule in panel.rules if rule != "degraded"]
        self._limits = [limit * panel.scale for limit in judged if limit is not None]
        self._low, self._high = self._range()

    def draw(self) -> None:
        """Everything of this panel."""
        self._frame()
        self._events()
        for line, course in self._lines:
            for begin, end in stretches(course.mean):
                self._band(course, line.color, begin, end)
                self._canvas.line(self._points(course.mean, begin, end), line.color, 1.6)
        for limit in self._limits:
            if self._low <= limit <= self._high:
                ends = [(self._left, self._y(limit)), (self._right, self._y(limit))]
                self._canvas.line(ends, RED, 1.0, dashed=True)
        self._legend()

    def _range(self) -> tuple[float, float]:
        """Over the values; a limit is shown where it is not far beyond them."""
        known = [part[np.isfinite(part)] for _, course in self._lines for part in (course.low, course.high)]
        values = np.concatenate(known) * self._panel.scale
        low, high = float(values.min()), float(values.max())
        for limit in self._limits:
            if limit <= 2.5 * max(abs(low), abs(high)):
                low, high = min(low, limit), max(high, limit)
        return value_range(low, high, from_zero=self._panel.from_zero)

    def _x(self, t_s: float) -> float:
        share = (t_s - self._courses.begin_s) / (self._courses.end_s - self._courses.begin_s)
        return self._left + min(1.0, max(0.0, share)) * (self._right - self._left)

    def _y(self, value: float) -> float:
        return self._bottom - (value - self._low) / (self._high - self._low) * (self._bottom - self._top)

    def _frame(self) -> None:
        canvas = self._canvas
        for value in ticks(self._low, self._high):
            canvas.line([(self._left, self._y(value)), (self._right, self._y(value))], GRID, 0.8)
            canvas.text(self._left - 6, self._y(value) + 4, number(value), 11, GREY, anchor="end")
        canvas.line([(self._left, self._bottom), (self._right, self._bottom)], GREY, 0.8)
        for t_s, name in times(self._courses.begin_s, self._courses.end_s):
            canvas.line([(self._x(t_s), self._bottom), (self._x(t_s), self._bottom + 4)], GREY, 0.8)
            anchor = "end" if self._x(t_s) > self._right - 18 else "middle"
            canvas.text(self._x(t_s), self._bottom + 17, name, 11, GREY, anchor=anchor)  # type: ignore[arg-type]

    def _events(self) -> None:
        """When a limit of this panel was exceeded, as a shade behind the lines."""
        for event in self._courses.events:
            if event["rule"] not in self._panel.rules:
                continue
            ended_s = event["ended_ns"] / 1e9 or self._courses.end_s
            x0, x1 = self._x(event["t_ns"] / 1e9), self._x(ended_s)
            if ended_s > self._courses.begin_s and x1 > x0:
                self._canvas.rect(
                    x0, self._top, x1 - x0, self._bottom - self._top, COLORS[event["level"]], opacity=0.12
                )

    def _points(self, values: Array, begin: int, end: int) -> list[Point]:
        t_s = self._courses.t_s[begin:end]
        points = [(self._x(t), self._y(v * self._panel.scale)) for t, v in zip(t_s, values[begin:end], strict=True)]
        # One value alone is a short stroke.
        return points if len(points) > 1 else [(points[0][0] - 1, points[0][1]), (points[0][0] + 1, points[0][1])]

    def _band(self, course: Course, color: str, begin: int, end: int) -> None:
        """From the least to the most."""
        if end - begin > 1:
            outline = self._points(course.low, begin, end) + self._points(course.high, begin, end)[::-1]
            self._canvas.area(outline, color, opacity=0.16)

    def _legend(self) -> None:
        canvas, y = self._canvas, self._top - 9
        canvas.text(self._left, y, f"{self._panel.title}, {self._panel.unit}", 13, INK, bold=True)
        x = self._right
        for line, course in reversed(self._lines):
            if not course.known:
                continue
            text = f"{line.label} {_newest(course, self._panel.scale)}".strip()
            canvas.text(x, y, text, 11.5, line.color, anchor="end", bold=True)
            x -= 6.6 * len(text) + 14


def _newest(course: Course, scale: float) -> str:
    value = course.mean[np.flatnonzero(np.isfinite(course.mean))[-1]] * scale
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def stretches(values: Array) -> list[tuple[int, int]]:
    """Begin and end of every run of known values."""
    known = np.concatenate([[False], np.isfinite(values), [False]])
    edges = np.flatnonzero(known[1:] != known[:-1])
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
