"""Errors of the calibration commands."""

from __future__ import annotations

from daemon.common.errors import DaemonError, InputError


class SourceError(InputError):
    """Unreadable or mismatched images; the message names the file."""


class KeptError(DaemonError):
    """A calibration was not written because the existing file is better."""
