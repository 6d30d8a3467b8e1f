"""The error of takes."""

from __future__ import annotations

from daemon.common.errors import DaemonError


class TakeError(DaemonError):
    """A take that cannot be read or written; the message names the file and what is wrong with it."""
