"""``fringed record``: start and stop takes of a running daemon, or record directly from a rig."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from daemon.cli.control.daemon_call import SLOW_S, call_daemon
from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys
from daemon.common.files import checked_name

_DIRECT = "direct"
_DURATION = re.compile(r"(\d{1,6}(?:\.\d{1,6})?) ?(ms|s|m|)")
_SUMMARY = ("pairs", "lone_frames", "parts", "bytes", "dropped", "interruptions", "unsynced_pairs", "problem")


class DirectGroup(TyperGroup):
    """``record RIG`` is short for ``record direct RIG``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Interpret the first argument as a sub-command if it is one, else all of them as those of ``direct``."""
        if args and args[0] not in (*self.commands, *ctx.help_option_names):
            args = [_DIRECT, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(cls=DirectGroup, add_completion=False, no_args_is_help=True, rich_markup_mode=None)

Endpoint = Annotated[str | None, typer.Option(help="Control endpoint of the daemon.")]
RigOption = Annotated[Path | None, typer.Option(help="Take the endpoint from this rig.yaml.")]


@app.callback()
def _root() -> None:
    """Record raw images: start and stop a take of a running daemon, or `record RIG` to record directly."""


@app.command()
def start(
    name: Annotated[str, typer.Option(help="Name of the take.")] = "take",
    before: Annotated[
        str, typer.Option(help="Start this long before now: 5s, 500ms, 1m; at most recording.before_s of rig.yaml.")
    ] = "0s",
    endpoint: Endpoint = None,
    rig: RigOption = None,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Start a take in a running daemon."""
    params: dict[str, Any] = {"name": checked_name(name)}
    if (before_s := seconds_of(before)) > 0:
        params["before_s"] = before_s
    answer = call_daemon("record.start", endpoint, rig, SLOW_S, chosen_keys(key, server_key), **params)
    early = f", including {answer['before_items']} earlier pairs and unpaired frames" if before_s > 0 else ""
    typer.echo(f"recording to {answer['file']}{early}")


def seconds_of(text: str) -> float:
    """``5s``, ``500ms``, ``1.5m`` or a plain number of seconds."""
    match = _DURATION.fullmatch(text.strip())
    if match is None:
        raise typer.BadParameter(f"{text!r} is no duration; use a form such as 5s, 500ms or 1m")
    return float(match[1]) * {"ms": 1e-3, "s": 1.0, "": 1.0, "m": 60.0}[match[2]]


@app.command()
def stop(
    endpoint: Endpoint = None, rig: RigOption = None, key: KeyOption = None, server_key: ServerKeyOption = None
) -> None:
    """Stop the take of a running daemon."""
    answer = call_daemon("record.stop", endpoint, rig, SLOW_S, chosen_keys(key, server_key))
    if "file" not in answer:
        typer.echo("no take is being written")
        return
    rest = ", ".join(f"{key} {answer[key]}" for key in _SUMMARY if answer.get(key))
    typer.echo(f"{answer['file']}: {rest}" if rest else answer["file"])


@app.command(_DIRECT)
def direct(
    rig: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="The rig file, rig.yaml.")],
    name: Annotated[str, typer.Option(help="Name of the take.")] = "take",
    seconds: Annotated[float | None, typer.Option(min=0.1, help="Stop after this time.")] = None,
) -> None:
    """Record directly from a rig, without a daemon, until Ctrl-C (the default: `fringed record RIG`)."""
    import threading

    from daemon.bootstrap.run import StopFlag, run_rig
    from daemon.bootstrap.systemd.logging_setup import log_events
    from daemon.cli.options.progress import rendering
    from daemon.common.files import restrict_umask

    checked_name(name)
    restrict_umask()
    log_events()
    with StopFlag().on_signals() as flag, rendering() as progress:
        timer: list[threading.Timer] = []

        def on_status(status: dict[str, Any]) -> None:
            if seconds is not None and status["pairs"] and not timer:
                timer.append(threading.Timer(seconds, flag.request))
                timer[0].daemon = True
                timer[0].start()

        run_rig(rig, progress=progress, flag=flag, record=name, on_status=on_status)
