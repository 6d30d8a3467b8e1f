"""``fringed uninstall``: remove the service; data and configuration are kept."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from daemon.apps.install.layout import PREFIX


def main(
    prefix: Annotated[Path, typer.Option(help="Directory of the program.")] = PREFIX,
    root: Annotated[Path, typer.Option(help="Remove it from the image below this directory.")] = Path("/"),
    purge: Annotated[bool, typer.Option("--purge", help="Remove takes, configuration, logs and users too.")] = False,
) -> None:
    """Remove the service. Configuration, takes and logs are kept unless --purge is given."""
    from daemon.apps.install.steps import uninstall
    from daemon.apps.install.target import Target

    uninstall(Target(root.absolute(), prefix), typer.echo, purge=purge)
