"""``fringed reload``, ``start``, ``stop``, ``snapshot`` and ``pattern``: one word to a running daemon."""

from __future__ import annotations

from typing import Annotated

import typer

from daemon.cli.control.ask import SLOW_S, Endpoint, RigFile, Timeout, ask
from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys


def reload(
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = SLOW_S,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Let a running daemon read rig.yaml and its files again: it takes over all of it, or nothing and says why."""
    changed = ask("reload", endpoint, rig, timeout, chosen_keys(key, server_key))["changed"]
    typer.echo(f"changed: {', '.join(changed)}" if changed else "nothing has changed")


def start(
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = 5.0,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Let a paused daemon measure again."""
    typer.echo(ask("start", endpoint, rig, timeout, chosen_keys(key, server_key))["state"])


def stop(
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = 5.0,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Let a daemon pause: it measures nothing and stays connected; `systemctl stop` or Ctrl-C ends it."""
    typer.echo(ask("stop", endpoint, rig, timeout, chosen_keys(key, server_key))["state"])


def snapshot(
    name: Annotated[str, typer.Option(help="Beginning of the file's name.")] = "snapshot",
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = SLOW_S,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Write the newest cloud of a running daemon into its directory of takes, as .npz."""
    answer = ask("snapshot", endpoint, rig, timeout, chosen_keys(key, server_key), name=name)
    typer.echo(f"{answer['file']}: {answer['points']} points, trigger {answer['seq']}")


def pattern(
    name: Annotated[str, typer.Argument(help="fringe, white, black, red, green or blue.")],
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = SLOW_S,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Let a running daemon's projector show the fringe, or a plain image (nothing is measured under it)."""
    typer.echo(
        f"shown: {ask('pattern.show', endpoint, rig, timeout, chosen_keys(key, server_key), name=name)['shown']}"
    )
