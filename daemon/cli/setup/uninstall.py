"""``fringed uninstall``: take the service away; data and configuration stay."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from daemon.apps.install.layout import PREFIX


def main(
    prefix: Annotated[Path, typer.Option(help="Where the program is.")] = PREFIX,
    root: Annotated[Path, typer.Option(help="Take it out of the image below this directory.")] = Path("/"),
    purge: Annotated[bool, typer.Option("--purge", help="Takes, configuration, logs and users too.")] = False,
) -> None:
    """Take the service away. Configuration, takes and logs stay unless --purge is given."""
    from daemon.apps.install.steps import uninstall
    from daemon.apps.install.target import Target

    uninstall(Target(root.absolute(), prefix), typer.echo, purge=purge)
