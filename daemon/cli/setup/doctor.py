"""``fringed doctor``: the problems of this machine and this rig, and their remedies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from daemon.apps.doctor.finding import Finding


def main(
    rig: Annotated[Path | None, typer.Argument(metavar="RIG.yaml", help="The rig; without it, the machine.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print plain JSON.")] = False,
    only: Annotated[list[str] | None, typer.Option(metavar="AREA", help="Check this area only; repeatable.")] = None,
) -> None:
    """Check everything that a rig needs; the exit status is 1 if there is a problem.

    Each finding is ok, a note (-), a warning or a PROBLEM; its remedy follows on the next line.
    """
    import json

    from daemon.apps.doctor import report, run_checks
    from daemon.apps.doctor.check_table import AREAS
    from daemon.apps.doctor.finding import exit_code

    unknown = sorted(set(only or ()) - {check.area for check in AREAS})
    if unknown:
        raise typer.BadParameter(
            f"unknown area {', '.join(unknown)}; the areas are: {', '.join(c.area for c in AREAS)}"
        )
    checks = [check for check in AREAS if not only or check.area in only]
    findings = run_checks.run_checks(rig, checks=checks, on_area=_quiet if as_json else _print)
    if as_json:
        typer.echo(json.dumps(report.as_json(findings, rig), indent=2))
    else:
        _show(report.skipped(findings))
        typer.echo(report.verdict(findings))
    if exit_code(findings):
        raise typer.Exit(1)


def _quiet(_: list[Finding]) -> None:
    """Print nothing; JSON is printed at the end."""


def _print(findings: list[Finding]) -> None:
    from daemon.apps.doctor import report

    _show([finding for finding in findings if finding.name not in report.SKIPPED])


def _show(findings: list[Finding]) -> None:
    from daemon.apps.doctor import report

    for line in report.lines(findings):
        area, mark, text = report.columns(line)
        level = line[2]
        body = typer.style(text, fg="bright_black") if level == "note" else text
        typer.echo(typer.style(area, bold=True) + typer.style(mark, fg=report.COLOURS[level]) + body)
