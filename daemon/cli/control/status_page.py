"""The live page of ``fringed status``, for a terminal of at least 80 columns."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from daemon.bootstrap.systemd.status_line import waiting
from daemon.cli.control.status_rows import drop_rows, rows
from fringed.errors import ControlError

_COLORS = {"running": "green", "degraded": "yellow", "paused": "cyan", "starting": "blue", "stopping": "red"}
_WIDE = 110
_CAMERA = {"acquiring": "green", "paused": "cyan", "lost": "red"}
_UPPER = frozenset(
    (
        "state",
        "first cloud",
        "warning",
        "device",
        "clouds",
        "points",
        "pairs",
        "latency",
        "published",
        "dropped",
        "at start",
    )
) | {"calibration"}
_BAR = 24


def watch(
    request: Callable[[], dict[str, Any]],
    console: Console,
    *,
    period_s: float = 0.5,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Show the page until Ctrl-C, also while the daemon does not answer."""
    last: dict[str, Any] | None = None
    with Live(console=console, screen=console.is_terminal, auto_refresh=False) as live:
        try:
            while True:
                try:
                    last, problem = request(), ""
                except ControlError as error:
                    problem = str(error)
                live.update(page(last, console.width, problem), refresh=True)
                sleep(period_s)
        except KeyboardInterrupt:
            return


def page(status: dict[str, Any] | None, width: int, problem: str = "") -> RenderableType:
    """The whole page."""
    parts: list[RenderableType] = []
    if problem:
        parts.append(Panel(Text(problem), title="no answer", border_style="red"))
    if status is None:
        return Group(*parts)
    parts.append(_head(status, stale=bool(problem)))
    boxes = (_measuring(status), _cameras(status))
    if width >= _WIDE:
        grid = Table.grid(expand=True)
        grid.add_column(ratio=1)
        grid.add_column(ratio=1)
        grid.add_row(*boxes)
        parts.append(grid)
    else:
        parts += boxes
    parts.append(_rest(status))
    parts.append(Text("Ctrl-C ends this page, not the daemon", style="dim"))
    return Group(*parts)


def _head(status: dict[str, Any], *, stale: bool) -> RenderableType:
    state = status["state"]
    line = Text.assemble(
        (f" {state.upper()} ", f"bold reverse {'white' if stale else _COLORS.get(state, 'white')}"),
        f"  {status['device']}  fringed {status['version']}  up {_ago(status['uptime_s'])}",
    )
    for reason in status["reasons"]:
        line.append(f"\n  {reason}", "yellow")
    if not status["clouds"]:
        line.append(f"\n  {waiting(status)}", "cyan")
    for warning in status["warnings"]:
        line.append(f"\n  {warning}", "magenta")
    return line


def _measuring(status: dict[str, Any]) -> RenderableType:
    table = _two_columns()
    clouds = (
        f"{status['cloud_rate_hz']:.1f} per second of {status['pair_rate_hz']:.1f} pairs, {status['clouds']} in all"
    )
    table.add_row("clouds", clouds)
    table.add_row("points", Text.assemble(f"{status['points']}  ", *_bar(status["valid"])))
    table.add_row("latency", _times(status["latency_ms"]) or "no cloud yet")
    table.add_row("published", _times(status["publish_latency_ms"]) or "no subscribers")
    stages = sorted(status["stages_ms"].items(), key=lambda stage: -stage[1])[:4]
    table.add_row("stages", ", ".join(f"{name} {ms:.0f}" for name, ms in stages) + (" ms" if stages else ""))
    for name, drops in drop_rows(status):
        table.add_row(name, ", ".join(f"{reason} {count}" for reason, count in drops.items()) or "none")
    return Panel(table, title="measuring", title_align="left")


def _cameras(status: dict[str, Any]) -> RenderableType:
    table = _two_columns()
    for side, camera in status["cameras"].items():
        state = camera["state"]
        warm = f", {camera['temperature_c']:.0f} °C" if camera["temperature_c"] is not None else ""
        lost = f", lost {camera['losses']} times" if camera["losses"] else ""
        line = Text.assemble((state, _CAMERA.get(state, "yellow")), f", {camera['rate_hz']:.1f} per second{warm}{lost}")
        table.add_row(side, line)
        outcomes = {name: count for name, count in camera["fates"].items() if count}
        table.add_row("", Text(", ".join(f"{name} {count}" for name, count in outcomes.items()) or "no frame", "dim"))
    return Panel(table, title="cameras", title_align="left")


def _rest(status: dict[str, Any]) -> RenderableType:
    """The remaining rows of the plain status."""
    table = _two_columns()
    shown = [(name, value) for name, value in rows(status) if name not in _UPPER]
    for name, value in _without_cameras(shown):
        table.add_row(name, Text(value.partition(";")[0] if name == "self-check" else value))
    problem = status.get("selfcheck", {}).get("problem")
    if problem:
        table.add_row("", Text(problem, "yellow"))
    table.add_row("calibration", Text(status["calibration"], overflow="ellipsis", no_wrap=True))
    return Panel(table, title="other", title_align="left")


def _without_cameras(shown: list[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    camera = False
    for name, value in shown:
        camera = name.startswith("camera ") or (camera and not name)
        if not camera:
            yield name, value


def _two_columns() -> Table:
    table = Table.grid(padding=(0, 1), expand=True)
    table.add_column(style="bold", no_wrap=True, width=11)
    table.add_column(ratio=1, overflow="fold")
    return table


def _bar(share: float) -> tuple[tuple[str, str], ...]:
    full = round(_BAR * min(1.0, max(0.0, share)))
    return ("█" * full, "green"), ("░" * (_BAR - full), "dim"), (f" {100 * share:.0f} %", "")


def _times(values: dict[str, float]) -> str:
    return "  ".join(f"{name} {value:.0f} ms" for name, value in values.items())


def _ago(seconds: float) -> str:
    minutes, hours = int(seconds) // 60, int(seconds) // 3600
    if hours:
        return f"{hours} h {minutes % 60} min"
    return f"{minutes} min {int(seconds) % 60} s" if minutes else f"{int(seconds)} s"
