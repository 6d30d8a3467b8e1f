"""What keeps an installation from being done."""

from __future__ import annotations

from daemon.common.errors import DaemonError


class InstallError(DaemonError):
    """Nothing, or only a part, was installed; the message names the next step."""
