"""Directories and addresses of the sockets: the service's runtime directory, the user's, or a private one in /tmp."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from daemon.common.errors import DaemonError

TCP_STREAM = "tcp://127.0.0.1:5555"
_SERVICE = Path("/run/fringed")  # RuntimeDirectory= of fringed.service


def runtime_dir() -> Path:
    """The directory for sockets, which may not exist yet: RUNTIME_DIRECTORY, else XDG_RUNTIME_DIR, else /tmp."""
    service = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if service:
        return Path(service)
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user) / "fringed" if user else Path(tempfile.gettempdir()) / f"fringed-{os.getuid()}"


def stream_endpoint() -> str:
    """The default ipc endpoint of the stream."""
    return f"ipc://{runtime_dir() / 'stream'}"


def control_endpoint() -> str:
    """The default endpoint of control."""
    return f"ipc://{runtime_dir() / 'control'}"


def found_control_endpoint() -> str:
    """The control endpoint of this user's daemon, or of the service where only that exists."""
    own = control_endpoint()
    service = _SERVICE / "control"
    with suppress(OSError):
        if not Path(own.removeprefix("ipc://")).exists() and service.exists():
            return f"ipc://{service}"
    return own


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
