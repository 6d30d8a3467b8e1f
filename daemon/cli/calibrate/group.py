"""``fringed calibrate``: the table of its commands."""

from __future__ import annotations

import typer

from daemon.cli.calibrate import board, check, exchange, refine, steps
from daemon.common.files import restrict_umask

app = typer.Typer(add_completion=False, no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _root() -> None:
    """Calibrate cameras, projector and colours from images of a board, and check a calibration."""
    restrict_umask()


app.command("board")(board.main)
app.command("cameras")(steps.cameras)
app.command("projector")(steps.projector)
app.command("color")(steps.color)
app.command("all")(steps.everything)
app.command("check")(check.main)
app.command("refine")(refine.main)
app.command("import")(exchange.import_calibration)
app.command("export")(exchange.export_calibration)
