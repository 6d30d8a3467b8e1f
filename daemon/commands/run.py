"""``fringed run``: measure until stopped."""

from __future__ import annotations

import logging
import signal
from pathlib import Path
from typing import Annotated

import typer


def main(
    rig: Annotated[Path, typer.Argument(help="The rig file, rig.yaml.")],
    record: Annotated[str | None, typer.Option(help="Begin a take of this name at once.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say more.")] = False,
) -> None:
    """Measure: run the daemon of a rig until SIGTERM or Ctrl-C."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a wish to reload must not end a daemon that starts or stops
    from daemon.commands.progress import rendering
    from daemon.launch import StopFlag, run_rig
    from daemon.supervision.log import log_events

    log_events(logging.DEBUG if verbose else logging.INFO)
    with StopFlag().on_signals() as flag, rendering() as progress:
        run_rig(rig, progress=progress, flag=flag, record=record)
