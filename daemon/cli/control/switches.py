"""``fringed reload``, ``start``, ``stop``, ``snapshot`` and ``pattern``: single commands for a running daemon."""

from __future__ import annotations

from typing import Annotated

import typer

from daemon.cli.control.daemon_call import SLOW_S, Endpoint, RigFile, Timeout, call_daemon
from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys
from daemon.common.files import checked_name


def reload(
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = SLOW_S,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Make a running daemon read rig.yaml and its files again: it applies all changes, or none with the reason."""
    changed = call_daemon("reload", endpoint, rig, timeout, chosen_keys(key, server_key))["changed"]
    typer.echo(f"changed: {', '.join(changed)}" if changed else "nothing has changed")


def start(
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = 5.0,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Resume measuring in a paused daemon."""
    typer.echo(call_daemon("start", endpoint, rig, timeout, chosen_keys(key, server_key))["state"])


def stop(
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = 5.0,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Pause a daemon: it stops measuring and stays connected; `systemctl stop` or Ctrl-C ends it."""
    typer.echo(call_daemon("stop", endpoint, rig, timeout, chosen_keys(key, server_key))["state"])


def snapshot(
    name: Annotated[str, typer.Option(help="Beginning of the file's name.")] = "snapshot",
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = SLOW_S,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Write the newest cloud of a running daemon into its directory of takes, as .npz."""
    name = checked_name(name)
    answer = call_daemon("snapshot", endpoint, rig, timeout, chosen_keys(key, server_key), name=name)
    typer.echo(f"{answer['file']}: {answer['points']} points, trigger {answer['seq']}")


def pattern(
    name: Annotated[str, typer.Argument(help="fringe, white, black, red, green or blue.")],
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = SLOW_S,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Show the fringe or a plain image, without measuring, on a running daemon's projector."""
    answer = call_daemon("pattern.show", endpoint, rig, timeout, chosen_keys(key, server_key), name=name)
    typer.echo(f"shown: {answer['shown']}")
