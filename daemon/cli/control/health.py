"""``fringed health``: the health of a running daemon, now and over the last hours."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated

import typer

from daemon.cli.control.daemon_call import control_endpoint

EXIT = {"healthy": 0, "warning": 0, "ill": 1, "unknown": 4}
NO_DAEMON = 3

_UNITS = {"s": 1, "m": 60, "min": 60, "h": 3600}


def main(
    endpoint: Annotated[str | None, typer.Option(help="Control endpoint of the daemon.")] = None,
    rig: Annotated[Path | None, typer.Option(help="Take the endpoint from this rig.yaml.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page with charts.")] = None,
    png: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the charts as an image.")] = None,
    last: Annotated[str, typer.Option(metavar="TIME", help="Period of the charts: 90s, 15min, 6h.")] = "1h",
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for each answer.")] = 5.0,
) -> None:
    """Report the health of a running daemon.

    Exit status: 0 healthy, or with a warning; 1 ill; 3 no daemon; 4 unknown, while it starts or is paused.
    """
    from daemon.apps.health_report.text import report_text
    from fringed.control.client import ControlClient
    from fringed.errors import ControlError

    seconds = span_s(last)
    with ControlClient(control_endpoint(endpoint, rig), timeout_s=timeout) as client:
        try:
            client.call("hello")
        except ControlError as error:
            typer.echo(f"fringed: {error}", err=True)
            raise typer.Exit(NO_DAEMON) from error
        report, events = client.call("health"), client.call("health.events", most=100)
        _write(client.call, seconds, html, png)
    typer.echo(json.dumps(report | {"events": events}, indent=2) if as_json else report_text(report, events))
    raise typer.Exit(EXIT[report["verdict"]])


def _write(call: object, seconds: float, html: Path | None, png: Path | None) -> None:
    """Write the requested files."""
    if html is None and png is None:
        return
    from daemon.apps.health_report import page, panels
    from daemon.common.files import write_atomically

    history = panels.request_history(call, seconds)  # type: ignore[arg-type]
    for path, render in ((html, page.html), (png, page.png)):
        if path is not None:
            write_atomically(path, render(history))
            typer.echo(f"wrote {path}", err=True)


def span_s(text: str) -> float:
    """Seconds of a span such as ``90s``, ``15min`` or ``6h``."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(s|m|min|h)", text)
    seconds = float(match[1]) * _UNITS[match[2]] if match else 0.0
    if not 10 <= seconds <= 72 * 3600:
        raise typer.BadParameter(
            f"{text!r} is no period from 10s to 72h; use a form such as 90s, 15min or 6h", param_hint="--last"
        )
    return seconds
