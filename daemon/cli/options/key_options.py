"""The options ``--key`` and ``--server-key`` of commands for a daemon on another machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fringed.keys import Keys

KeyOption = Annotated[
    Path | None,
    typer.Option(
        "--key", envvar="FRINGED_KEY", metavar="NAME.key", help="For a daemon on another machine: your own key."
    ),
]
ServerKeyOption = Annotated[
    Path | None,
    typer.Option(
        "--server-key",
        envvar="FRINGED_SERVER_KEY",
        metavar="server.pub",
        help="For a daemon on another machine: its public key.",
    ),
]


def chosen_keys(key: Path | None, server_key: Path | None) -> Keys | None:
    """The keys of the two options, None without them."""
    if key is None and server_key is None:
        return None
    if key is None or server_key is None:
        raise typer.BadParameter("--key and --server-key belong together: your own key, and the daemon's public one")
    return Keys.load(key, server_key)
