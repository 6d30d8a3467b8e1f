"""``fringed status``: the status of a running daemon."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from daemon.cli.control.daemon_call import control_endpoint
from daemon.cli.control.status_rows import table
from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys


def main(
    endpoint: Annotated[str | None, typer.Option(help="Control endpoint of the daemon.")] = None,
    rig: Annotated[Path | None, typer.Option(help="Take the endpoint from this rig.yaml.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Print it once; the default without a terminal.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status once, as JSON.")] = False,
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the answer.")] = 5.0,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Show the status of a running daemon: a live page on a terminal, until Ctrl-C."""
    from rich.console import Console

    from fringed.control.client import ControlClient

    console, keys = Console(), chosen_keys(key, server_key)
    with ControlClient(control_endpoint(endpoint, rig), timeout_s=timeout, keys=keys) as client:
        status = client.call("status")  # fails at once without a daemon
        if as_json:
            typer.echo(json.dumps(status, indent=2))
        elif once or not console.is_terminal:
            typer.echo(table(status))
        else:
            from daemon.cli.control.status_page import watch

            watch(lambda: dict(client.call("status")), console)
