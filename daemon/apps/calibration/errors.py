"""What can go wrong between images and a calibration file."""

from __future__ import annotations

from daemon.common.errors import DaemonError


class SourceError(DaemonError):
    """Images that cannot be read, or that do not belong together; the message names the file."""


class KeptError(DaemonError):
    """A calibration that was not written because the one in its place is better."""
