"""``fringed calibrate board``: a calibration board to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

BOARD_HELP = (
    "circles:COLSxROWS:PITCH_MM, acircles:..., chessboard:INNERCOLSxINNERROWS:SQUARE_MM or "
    "charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICT."
)


def main(
    pdf: Annotated[Path, typer.Option("--pdf", help="Write the page here.")],
    board: Annotated[str, typer.Argument(help=f"{BOARD_HELP}")] = "circles:11x9:32:20",
    paper: Annotated[
        str, typer.Option(help="a4 to a0, or such as 420x297 (mm).", show_default="the smallest that fits")
    ] = "",
) -> None:
    """Print a calibration board: a PDF to scale, with its description and a ruler to check the scale."""
    from daemon.apps.calibration.board_print.board_sheet import board_sheet
    from daemon.common.files import write_atomically
    from pipeline.calibrate.targets.board.board import parse_board

    sheet = board_sheet(parse_board(board), paper)
    write_atomically(pdf, sheet.data)
    typer.echo(
        f"{pdf}: {sheet.board} on {sheet.paper}, {sheet.width_mm:g} x {sheet.height_mm:g} mm; "
        "print it at 100 %, check that its ruler measures 100 mm, and glue it to a flat plate"
    )
