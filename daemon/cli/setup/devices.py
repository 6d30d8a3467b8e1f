"""``fringed devices``: cameras and projector outputs, with their keys in rig.yaml."""

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
    """List cameras and projector outputs with their keys in rig.yaml; cameras in use are not disturbed."""
    import json

    import msgspec

    from daemon.apps.doctor import device_inventory

    for path in producer or ():
        if not path.is_file():
            raise FileNotFoundError(f"GenTL producer {path}: the file does not exist")
    inventory = device_inventory.inventory(tuple(path.resolve() for path in producer or ()), display)
    if as_json:
        typer.echo(json.dumps(msgspec.to_builtins(inventory), indent=2))
        return
    for text, heading in device_inventory.lines(inventory):
        typer.echo(typer.style(text, bold=heading))
    for problem in inventory.problems:
        typer.echo(f"note: {problem}", err=True)
