"""Addresses of daemons: the forms that are valid, and the sockets of this machine."""

from __future__ import annotations

import os
import re
import socket
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

from fringed.errors import ArgumentError

RESOLVE_S = 0.8
"""Longest wait for the address of a host name; the system's resolver may take half a minute."""

FORMS = "tcp://HOST:PORT or ipc://PATH"
TCP_STREAM = "tcp://127.0.0.1:5555"
"""The default tcp endpoint of the stream."""

_SERVICE = Path("/run/fringed")  # RuntimeDirectory= of fringed.service
_TCP = re.compile(r"(\[[0-9A-Fa-f:.%\w]+\]|[^\s:/\[\]]+):(\d+)")


def checked_endpoint(endpoint: object, *, name: str = "endpoint") -> str:
    """Return an endpoint that a client can connect to.

    Raises:
        ArgumentError: another type or form, a port out of range, or a host name that is unknown.
    """
    if not isinstance(endpoint, str):
        raise ArgumentError(f"{name} is of type {type(endpoint).__name__}, expected a text, {FORMS}")
    problem = form_problem(endpoint) or host_problem(endpoint)
    if problem:
        raise ArgumentError(f"{name} {endpoint!r:.200} cannot be used: {problem}")
    return endpoint


def form_problem(endpoint: str) -> str:
    """Why this text is no address; empty if it is one."""
    scheme, separator, rest = endpoint.partition("://")
    if scheme == "ipc" and rest:
        return ""
    if scheme != "tcp" or not separator:
        return f"that is no address, use {FORMS}"
    match = _TCP.fullmatch(rest.rpartition(";")[2])
    if match is None:
        return "host or port is missing or invalid, use tcp://HOST:PORT"
    if not 1 <= int(match[2]) <= 65535:
        return f"port {match[2]} is not in 1 to 65535"
    if match[1] in ("*", "0.0.0.0", "[::]"):  # noqa: S104 - an address to bind, which is refused here
        return f"{match[1]} is an address to listen on; name the daemon's machine"
    return ""


def host_of(endpoint: str) -> str:
    """The host of a tcp address, without brackets; empty for ipc."""
    scheme, _, rest = endpoint.partition("://")
    return rest.rpartition(";")[2].rpartition(":")[0].strip("[]") if scheme == "tcp" else ""


def port_of(endpoint: str) -> int:
    """The port of a valid tcp address."""
    return int(endpoint.rpartition(":")[2])


def host_problem(endpoint: str) -> str:
    """Why the host of an address is unknown; resolved in a thread of its own, for a bounded time."""
    host = host_of(endpoint)
    if not host:
        return ""
    found: list[bool] = []

    def resolve() -> None:
        with suppress(OSError, UnicodeError):
            found.append(bool(socket.getaddrinfo(host, None)))

    thread = threading.Thread(target=resolve, daemon=True)
    thread.start()
    thread.join(RESOLVE_S)
    return "" if found else f"the host name {host!r} is unknown"


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
