"""``fringed info``: the contents of a take, and whether it is complete."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

_LONG_BYTES = 100 << 20  # smaller takes are read without a progress bar


def main(
    take: Annotated[Path, typer.Argument(help="The take: its first file, or one of its parts.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print plain JSON.")] = False,
) -> None:
    """Show the contents of a take and whether it is complete; exit status 1 if it is not."""
    import json

    from daemon.cli.options.progress import rendering
    from daemon.recording.read.inspect import inspect
    from daemon.recording.read.take_reader import TakeReader

    with TakeReader(take) as reader, rendering(f"Reading {take.name}") as progress:
        long = reader.size > _LONG_BYTES
        report = inspect(reader, (lambda position: progress(position, reader.size)) if long else None)
    if as_json:
        typer.echo(json.dumps(report, indent=2))
    else:
        _print(report)
    if not report["whole"] or report["attachment_problems"]:
        raise typer.Exit(1)


def _print(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows(report):
        table.add_row(name, value)
    Console(highlight=False, markup=False).print(table)


def rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """The lines of the table."""
    yield "take", f"{report['take']}, version {report['version']}, device {report['device']}"
    yield "session", str(report["session"])
    for part in report["parts"] if len(report["parts"]) > 1 else ():
        yield "part", f"{part['file']}, {part['bytes'] / 1e6:.1f} MB"
    yield "size", f"{report['bytes'] / 1e6:.1f} MB in {len(report['parts'])} file(s)"
    yield "pairs", str(report["pairs"])
    for name in ("unpaired", "duplicates"):
        counts = report[name]
        yield name, f"left {counts['left']}, right {counts['right']}"
    yield "images", ", ".join(f"{count} {name}" for name, count in report["pictures"].items()) or "none"
    yield from _time_rows(report)
    yield from _attachment_rows(report)
    problems = report["problems"] + report["attachment_problems"]
    yield "whole", "yes" if not problems else "NO"
    for problem in problems:
        yield "problem", problem


def _time_rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    if report["first_sequence"] is not None:
        yield "sequence", f"{report['first_sequence']} to {report['last_sequence']}, {report['missing']} missing"
    if report["gaps"]:
        yield "gaps", ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in report["gaps"])
    rate = f", {report['rate_hz']:.2f} per second" if report["rate_hz"] else ""
    yield "duration", f"{report['duration_s']:.2f} s{rate}"


def _attachment_rows(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "attached", ", ".join(f"{name} ({size} B)" for name, size in report["attachments"].items()) or "nothing"
    if "calibration" in report:
        yield "calibration", f"{report['calibration']}, baseline {report['baseline_mm']:.1f} mm"
    if "pattern" in report:
        pattern = report["pattern"]
        size = " x ".join(str(n) for n in pattern["size"])
        if "sequence" in pattern:
            yield "pattern", f"sequence {pattern['sequence']!r} of {pattern['frames']} images, {size}"
        else:
            fringe = f"{pattern['fringe']} fringe, {pattern['periods']:g} periods along {pattern['axis']}"
            yield "pattern", f"{fringe}, {size}"
    if "volume" in report:
        yield "volume", f"{report['volume']['near_mm']:g} to {report['volume']['far_mm']:g} mm"
