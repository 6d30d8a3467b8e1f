"""``fringed mode``: the number of images per cloud in a running daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from daemon.cli.control.daemon_call import control_endpoint

_TIMEOUT_S = 200.0  # the mode's kernels may have to be compiled


def main(
    name: Annotated[
        str | None, typer.Argument(help="single, two_color, heterodyne or gray; without it, show the mode.")
    ] = None,
    endpoint: Annotated[str | None, typer.Option(help="Control endpoint of the daemon.")] = None,
    rig: Annotated[Path | None, typer.Option(help="Take the endpoint from this rig.yaml.")] = None,
) -> None:
    """Show or change the mode of a running daemon, until it ends; rig.yaml sets the initial mode."""
    from fringed.control.client import ControlClient

    with ControlClient(control_endpoint(endpoint, rig), timeout_s=_TIMEOUT_S) as client:
        answer = client.call("pattern.mode", **({} if name is None else {"name": name}))
    rest = {key: value for key, value in answer.items() if key != "mode" and value not in ([], 0)}
    typer.echo(", ".join([answer["mode"], *(f"{key} {value}" for key, value in rest.items())]))
