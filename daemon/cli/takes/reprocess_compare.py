"""``fringed reprocess --set key=1,2,3``: settings compared on a sample of pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from daemon.apps.reprocess.engine.tasks import Engine
    from daemon.apps.reprocess.job import Job
    from daemon.apps.reprocess.plan.recordings import Recording

_SHOWN = 20


def compare(job: Job, recordings: list[Recording], out: str, grid: list[str], sample: int, engine: Engine) -> None:
    """Print the table of all combinations and write the page; exit status 1 if a recording failed."""
    from rich.console import Console
    from rich.table import Table

    from daemon.apps.reprocess.locations import location
    from daemon.apps.reprocess.report.page import GRID_HEAD, grid_cells
    from daemon.apps.reprocess.report.write import write_grid
    from daemon.apps.reprocess.settings_grid import combinations, search
    from daemon.cli.options.set_option import parsed_values

    values = parsed_values(grid)
    rows = [row.as_json() for row in search(job, recordings, combinations(values), sample, engine)]
    page = write_grid(location(out), job, rows, sample)
    table = Table()
    for column in (*values, *GRID_HEAD):
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*grid_cells(row, list(values)))
    Console(highlight=False, markup=False).print(table)
    failures = [failure for row in rows for failure in row["failures"]]
    for failure in failures[:_SHOWN]:
        typer.echo(f"failed: {failure}", err=True)
    typer.echo(f"report: {page}")
    if failures:
        raise typer.Exit(1)
