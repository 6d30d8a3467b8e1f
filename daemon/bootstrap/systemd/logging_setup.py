"""Where log lines go: the journal with fields when systemd started the program, else standard error."""

from __future__ import annotations

import logging
import os
import sys

from daemon.bootstrap.systemd.journal import JournalHandler, begun_by_systemd

_FORMAT = "%(asctime)s %(levelname).1s %(name)s: %(message)s"


def log_events(level: int = logging.INFO) -> None:
    """Send the root logger's lines to where they belong."""
    stderr = logging.StreamHandler(sys.stderr)
    stderr.setFormatter(logging.Formatter(_FORMAT))
    journal = begun_by_systemd(os.environ)
    handler = JournalHandler(beside=stderr) if journal else stderr
    logging.basicConfig(level=level, handlers=[handler])
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # it counts its threads aloud


def tell_fields(**fields: str) -> None:
    """Put these into every line from now on, where the lines have fields."""
    for handler in logging.getLogger().handlers:
        if isinstance(handler, JournalHandler):
            handler.fields.update(fields)
