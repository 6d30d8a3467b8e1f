"""Errors of an installation."""

from __future__ import annotations

from daemon.common.errors import DaemonError


class InstallError(DaemonError):
    """An incomplete installation; the message names the next step."""
