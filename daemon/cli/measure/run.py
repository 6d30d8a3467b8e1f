"""``fringed run``: measure until stopped."""

from __future__ import annotations

import logging
import os
import signal
from pathlib import Path
from typing import Annotated

import typer

WRONG_CONFIG = 78
"""Exit status for a service manager: the rig file is invalid, a restart does not help (EX_CONFIG of sysexits.h)."""


def main(
    rig: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="The rig file, rig.yaml.")],
    record: Annotated[str | None, typer.Option(help="Start a take of this name at once.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print more messages.")] = False,
) -> None:
    """Measure: run the daemon of a rig until SIGTERM or Ctrl-C."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a request to reload must not end a daemon that starts or stops
    from daemon.bootstrap.run import StopFlag, run_rig
    from daemon.bootstrap.systemd.logging_setup import log_events
    from daemon.cli.options.progress import rendering
    from daemon.common.errors import ConfigError
    from daemon.common.files import checked_name, restrict_umask

    if record is not None:
        checked_name(record)
    restrict_umask()
    log_events(logging.DEBUG if verbose else logging.INFO)
    supervised = "NOTIFY_SOCKET" in os.environ
    with StopFlag().on_signals() as flag, rendering() as progress:
        try:
            run_rig(rig, progress=progress, flag=flag, record=record)
        except ConfigError as error:
            if not supervised:
                raise
            logging.getLogger("fringed").critical("%s", error)
            raise typer.Exit(WRONG_CONFIG) from error
