"""``fringed devices``: cameras and projector outputs, with what rig.yaml calls them by."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def main(
    as_json: Annotated[bool, typer.Option("--json", help="Print plain JSON.")] = False,
    producer: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="GenTL producer (.cti); repeatable.", show_default="GENICAM_GENTL64_PATH"),
    ] = None,
    display: Annotated[str, typer.Option(help="X display such as :0.", show_default="DISPLAY")] = "",
) -> None:
    """List cameras and projector outputs, with the keys that name them in rig.yaml; no open camera is disturbed."""
    import json

    import msgspec

    from daemon.apps.doctor import device_inventory

    for path in producer or ():
        if not path.is_file():
            raise FileNotFoundError(f"there is no GenTL producer {path}")
    found = device_inventory.take(tuple(path.resolve() for path in producer or ()), display)
    if as_json:
        typer.echo(json.dumps(msgspec.to_builtins(found), indent=2))
        return
    for text, heading in device_inventory.lines(found):
        typer.echo(typer.style(text, bold=heading))
    for problem in found.problems:
        typer.echo(f"note: {problem}", err=True)
