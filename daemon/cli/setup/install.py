"""``fringed install``: install the daemon on this machine as a service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from daemon.apps.install.layout import PREFIX


def main(
    rig: Annotated[Path | None, typer.Option(help="Initial rig.yaml; without it, a simulated rig.")] = None,
    prefix: Annotated[Path, typer.Option(help="Directory of the program, used for nothing else.")] = PREFIX,
    root: Annotated[Path, typer.Option(help="Install into the image of a machine below this directory.")] = Path("/"),
    python: Annotated[
        Path | None, typer.Option(help="Interpreter of the service.", show_default="the running one")
    ] = None,
    wheelhouse: Annotated[Path | None, typer.Option(help="Install from this directory of wheels, no index.")] = None,
    share_packages: Annotated[
        bool, typer.Option("--share-packages", help="Use this environment's packages in place; no download.")
    ] = False,
    start: Annotated[bool, typer.Option(help="Start now and at boot.")] = True,
    view: Annotated[bool, typer.Option(help="Start the viewer for browsers of this machine too.")] = False,
    compile_kernels: Annotated[bool, typer.Option("--compile/--no-compile", help="Compile the kernels ahead.")] = True,
) -> None:
    """Install the daemon as a systemd service: /opt/fringed, /etc/fringed, /var/lib/fringed. Repeatable."""
    from daemon.apps.install.environment import Source, default_python
    from daemon.apps.install.steps import InstallOptions, install
    from daemon.apps.install.target import Target

    source = Source((python or default_python()).absolute(), wheelhouse and wheelhouse.absolute(), share_packages)
    options = InstallOptions(rig, start=start, view=view, compile=compile_kernels)
    install(Target(root.absolute(), prefix), source, options, typer.echo)
