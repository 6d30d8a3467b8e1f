"""``fringed calibrate import`` and ``export``: calibrations of OpenCV, Kalibr and ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_FORMATS = "opencv (FileStorage), kalibr (camchain) or ros (camera_info, left and right)."


def import_calibration(
    files: Annotated[list[Path], typer.Argument(help="Files that belong together; for ROS the left, then the right.")],
    out: Annotated[Path, typer.Option("--out", help="Write this calibration.")],
    form: Annotated[str, typer.Option("--format", help=_FORMATS, show_default="by content")] = "",
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT of the images, for OpenCV files without it.")] = "",
    unit_mm: Annotated[float, typer.Option(min=1e-6, help="Millimetres of one unit of OpenCV's T: 1000 for m.")] = 1.0,
    force: Annotated[bool, typer.Option("--force", help="Replace a better calibration too.")] = False,
) -> None:
    """Convert another program's files to a calibration file; a projector and colours are calibrated afterwards."""
    from daemon.apps.calibration.exchange import read_foreign
    from daemon.apps.calibration.solve.archive import existing, store
    from daemon.apps.calibration.solve.keep_colors import with_old_colors

    imported = read_foreign(files, form=form, size=_size(size), unit_mm=unit_mm)
    cameras, notes = with_old_colors(imported.cameras, existing(out) if not force else None)
    quality = {"imported_from": imported.form, "imported_files": [path.name for path in files]}
    stored = store(out, cameras, quality=quality, force=force)
    for note in [*imported.notes, *notes, *stored.notes]:
        typer.echo(f"note: {note}", err=True)
    typer.echo(f"{out}: baseline {cameras.baseline_mm:.2f} mm, {stored.identity}")
    if stored.kept is not None:
        typer.echo(f"the previous file is kept as {stored.kept}")


def export_calibration(
    calibration: Annotated[Path, typer.Argument(help="calibration.yaml")],
    form: Annotated[str, typer.Option("--format", help=_FORMATS)],
    out: Annotated[Path, typer.Option("--out", help="Directory for the files.")] = Path(),
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
) -> None:
    """Write a calibration for OpenCV, Kalibr or ROS, with notes about what the format cannot represent."""
    from daemon.apps.calibration.exchange import write_foreign
    from daemon.common.errors import InputError
    from daemon.common.files import write_atomically
    from daemon.rig.calibration_file import read_cameras

    files, notes = write_foreign(read_cameras(calibration).cameras, form)
    present = [out / name for name in files if (out / name).exists()]
    if present and not force:
        raise InputError(f"{present[0]} exists already; --force replaces it")
    out.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        write_atomically(out / name, data)
        typer.echo(f"{out / name}")
    for note in notes:
        typer.echo(f"note: {note}", err=True)


def _size(text: str) -> tuple[int, int] | None:
    import re

    if not text:
        return None
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise typer.BadParameter(f"--size {text}: expected WIDTHxHEIGHT")
    return int(match[1]), int(match[2])
