"""``fringed calibrate``: the commands, each in a module of its own that is imported when it runs."""

from __future__ import annotations

import typer

from daemon.commands import calibrate_board, calibrate_check, calibrate_exchange, calibrate_refine, calibrate_steps
from daemon.security.modes import keep_from_others

app = typer.Typer(add_completion=False, no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _root() -> None:
    """Calibrate cameras, projector and colours from pictures of a board, and check that they are still true."""
    keep_from_others()


app.command("board")(calibrate_board.main)
app.command("cameras")(calibrate_steps.cameras)
app.command("projector")(calibrate_steps.projector)
app.command("color")(calibrate_steps.color)
app.command("all")(calibrate_steps.everything)
app.command("check")(calibrate_check.main)
app.command("refine")(calibrate_refine.main)
app.command("import")(calibrate_exchange.bring)
app.command("export")(calibrate_exchange.give)
