"""Binding of the stream's socket: private directories, stale socket files, free ports."""

from __future__ import annotations

import socket
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import zmq

from daemon.common.errors import DaemonError
from daemon.common.ipc_endpoints import prepare_ipc, share_ipc

_MAX_IPC_BYTES = 107  # sun_path of Linux


def bind_all(publisher: zmq.Socket[Any], endpoints: Iterable[str]) -> list[str]:
    """Bind every endpoint; returns them with the ports that ``*`` or 0 became.

    Raises:
        DaemonError: an endpoint that is in use or not possible.
    """
    return [_bind(publisher, endpoint) for endpoint in endpoints]


def remove_files(endpoints: Iterable[str]) -> None:
    """Remove the socket files of closed endpoints, unless another daemon uses them by now."""
    for endpoint in endpoints:
        if endpoint.startswith("ipc://"):
            with suppress(DaemonError, OSError):
                _clear(Path(endpoint.removeprefix("ipc://")), endpoint)


def _bind(publisher: zmq.Socket[Any], endpoint: str) -> str:
    if endpoint.startswith("ipc://"):
        prepare_ipc(endpoint)
        _clear(Path(endpoint.removeprefix("ipc://")), endpoint)
    if endpoint.startswith("tcp://") and endpoint.endswith(":0"):
        endpoint = endpoint[:-1] + "*"
    try:
        publisher.bind(endpoint)
        share_ipc(endpoint)
    except (zmq.ZMQError, OSError) as error:
        raise DaemonError(
            f"stream: cannot bind {endpoint}: {error}; stop what uses it or change stream.endpoints"
        ) from error
    bound: bytes = publisher.getsockopt(zmq.LAST_ENDPOINT)  # type: ignore[assignment]
    return bound.rstrip(b"\0").decode()


def _clear(path: Path, endpoint: str) -> None:
    """Remove the socket file of a daemon that died; raise if a daemon answers.

    ZeroMQ itself would replace the file of a running daemon without an error.
    """
    if len(str(path).encode()) > _MAX_IPC_BYTES:
        raise DaemonError(f"stream: the path of {endpoint} is longer than {_MAX_IPC_BYTES} bytes; choose a shorter one")
    if not path.exists():
        return
    if not stat.S_ISSOCK(path.stat().st_mode):
        raise DaemonError(f"stream: {path} exists and is no socket; remove it or change stream.endpoints")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
            return
    raise DaemonError(f"stream: another daemon already publishes on {endpoint}; stop it or change stream.endpoints")
