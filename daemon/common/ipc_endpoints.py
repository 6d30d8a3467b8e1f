"""Directories and files of local sockets; ``fringed.control.address`` has the default addresses."""

from __future__ import annotations

import os
from pathlib import Path

from daemon.common.errors import DaemonError


def runtime_beside(endpoint: str) -> Path | None:
    """The directory of an ipc endpoint, for other short-lived files of the same daemon; None without one."""
    return Path(endpoint.removeprefix("ipc://")).parent if endpoint.startswith("ipc://") else None


def share_ipc(endpoint: str) -> None:
    """Let the group of a socket's directory connect; ZeroMQ uses the umask, which would exclude the group."""
    if endpoint.startswith("ipc://"):
        Path(endpoint.removeprefix("ipc://")).chmod(0o660)


def prepare_ipc(endpoint: str) -> None:
    """Create the directory of an ipc endpoint, for this user alone; rejects one that belongs to another user."""
    if not endpoint.startswith("ipc://"):
        return
    directory = Path(endpoint.removeprefix("ipc://")).parent
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    owner = directory.stat().st_uid
    if directory.name.startswith("fringed") and owner != os.getuid():
        raise DaemonError(
            f"the socket directory {directory} belongs to user {owner}, not to you; remove it or set XDG_RUNTIME_DIR"
        )
