"""``fringed mode``: how many images make a cloud in a running daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from daemon.cli.control.ask import control_endpoint

_PATIENCE_S = 200.0  # kernels that were never used are compiled


def main(
    name: Annotated[
        str | None, typer.Argument(help="single, two_color, heterodyne or gray; none = tell what it is.")
    ] = None,
    endpoint: Annotated[str | None, typer.Option(help="Control endpoint of the daemon.")] = None,
    rig: Annotated[Path | None, typer.Option(help="Take the endpoint from this rig.yaml.")] = None,
) -> None:
    """Tell or change the mode of a running daemon, until it ends; rig.yaml says with which it begins."""
    from daemon.control.rpc.client import ControlClient

    with ControlClient(control_endpoint(endpoint, rig), timeout_s=_PATIENCE_S) as client:
        told = client.call("pattern.mode", **({} if name is None else {"name": name}))
    rest = {key: value for key, value in told.items() if key != "mode" and value not in ([], 0)}
    typer.echo(", ".join([told["mode"], *(f"{key} {value}" for key, value in rest.items())]))
