"""``fringed calibrate refine``: correct a small drift from ordinary scenes, after confirmation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def main(
    source: Annotated[Path, typer.Argument(help="A take of ordinary scenes, or the rig.yaml of a rig at rest.")],
    calibration: Annotated[Path, typer.Option(help="The calibration to correct.")] = Path("calibration.yaml"),
    out: Annotated[
        Path | None, typer.Option(help="Write here instead of replacing --calibration; a replaced file is kept.")
    ] = None,
    device: Annotated[str | None, typer.Option(help="The device that moved: left, right or projector.")] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Write without confirmation.")] = False,
) -> None:
    """Correct the rotation of one device from the residuals of ordinary images; print the change, then confirm it."""
    from daemon.apps.calibration.solve import archive
    from daemon.apps.calibration.views.drift_pairs import from_rig, from_take
    from daemon.cli.options.progress import rendering
    from daemon.rig.calibration_file import read_calibration
    from pipeline.calibrate.drift_correction import refine, table
    from pipeline.monitor.explain import DEVICES

    if device is not None and device not in DEVICES:
        raise typer.BadParameter(f"--device is {device!r}, expected one of {', '.join(DEVICES)}")
    file = read_calibration(calibration)
    with rendering("Reading pairs") as progress:
        drift = (from_rig if source.suffix in (".yaml", ".yml") else from_take)(source, progress)
    with rendering("Estimating the drift") as progress:
        refinement = refine(
            file.calibration, drift.pattern, drift.volume, drift.encoding, drift.pairs, device=device, progress=progress
        )
    for line in table(refinement):
        typer.echo(line)
    if not refinement.better:
        typer.echo("the correction does not improve the validation pairs: nothing is written", err=True)
        raise typer.Exit(1)
    target = out if out is not None else calibration
    if not yes and not typer.confirm(f"write {target}?", default=False):
        typer.echo("nothing was written")
        raise typer.Exit(1)
    quality = file.mapping.get("quality")
    notes = {
        "refined": {
            "from": file.identity,
            "device": refinement.device,
            "turn_deg": list(refinement.turn_deg),
            "before_px": {name: one.value for name, one in refinement.before.items() if name.endswith("_px")},
            "after_px": {name: one.value for name, one in refinement.after.items() if name.endswith("_px")},
        }
    }
    stored = archive.store(
        target, refinement.calibration, quality=(dict(quality) if isinstance(quality, dict) else {}) | notes
    )
    typer.echo(f"wrote {stored.path}, {stored.identity}")
    if stored.kept is not None:
        typer.echo(f"the previous file is kept as {stored.kept}")
