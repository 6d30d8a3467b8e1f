"""The log's destination: the journal, with fields, when systemd started the program, else standard error."""

from __future__ import annotations

import logging
import os
import sys

from daemon.bootstrap.systemd.journal import JournalHandler, started_by_systemd

_FORMAT = "%(asctime)s %(levelname).1s %(name)s: %(message)s"


def log_events(level: int = logging.INFO) -> None:
    """Send the root logger's lines to their destination."""
    stderr = logging.StreamHandler(sys.stderr)
    stderr.setFormatter(logging.Formatter(_FORMAT))
    journal = started_by_systemd(os.environ)
    handler = JournalHandler(fallback=stderr) if journal else stderr
    logging.basicConfig(level=level, handlers=[handler])
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # it logs its number of threads


def set_fields(**fields: str) -> None:
    """Put these fields into every line of the journal from now on."""
    for handler in logging.getLogger().handlers:
        if isinstance(handler, JournalHandler):
            handler.fields.update(fields)
