"""The control socket: one thread owns a ROUTER and answers requests one after the other."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from pathlib import Path

import zmq

from daemon.control.protocol import MAX_BYTES, Method, answer
from daemon.errors import DaemonError
from daemon.runtime import prepare_ipc

log = logging.getLogger("fringed.control")

_MOST_PARTS = 3


class ControlServer:
    """Answers JSON-RPC on an endpoint from :meth:`start` to :meth:`close`.

    A message over 64 KiB disconnects its sender before it is held in memory.
    """

    def __init__(self, endpoint: str, methods: Mapping[str, Method]) -> None:
        self._methods = dict(methods)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context(io_threads=1)
        self._socket = self._context.socket(zmq.ROUTER)
        for option, value in (
            (zmq.LINGER, 200),
            (zmq.MAXMSGSIZE, MAX_BYTES),
            (zmq.RCVHWM, 64),
            (zmq.SNDHWM, 64),
            # Not ZeroMQ's heartbeats: with a full queue they can end the process (libzmq #3937).
            (zmq.TCP_KEEPALIVE, 1),
            (zmq.TCP_KEEPALIVE_IDLE, 30),
            (zmq.HANDSHAKE_IVL, 2000),
        ):
            self._socket.setsockopt(option, value)
        try:
            prepare_ipc(endpoint)
            _refuse_if_alive(endpoint)
            self._socket.bind(endpoint)
        except (zmq.ZMQError, OSError, DaemonError) as error:
            self._context.destroy(linger=0)
            if isinstance(error, DaemonError):
                raise
            raise DaemonError(f"control cannot listen on {endpoint}: {error}") from error
        self.endpoint = self._socket.getsockopt(zmq.LAST_ENDPOINT).rstrip(b"\0").decode()  # type: ignore[union-attr]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def close(self) -> None:
        """Answer no more; the socket file is removed."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)
        if not self._thread.is_alive():
            self._context.destroy(linger=200)
        if self.endpoint.startswith("ipc://"):
            Path(self.endpoint.removeprefix("ipc://")).unlink(missing_ok=True)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                if self._socket.poll(100):
                    self._serve_one(self._socket.recv_multipart())
            except zmq.ZMQError as error:
                if error.errno == zmq.ETERM:
                    return
                log.warning("control: %s", error)

    def _serve_one(self, parts: list[bytes]) -> None:
        """Request parts: sender, perhaps an empty one (REQ sockets), the JSON text."""
        if not 2 <= len(parts) <= _MOST_PARTS or (len(parts) == _MOST_PARTS and parts[1]):
            log.warning("control: a message of %d parts is not a request", len(parts))
            return
        response = answer(parts[-1], self._methods)
        if response is not None:
            self._socket.send_multipart([*parts[:-1], response])


def _refuse_if_alive(endpoint: str) -> None:
    """Two daemons on one ipc path would steal it from each other: the later one is refused."""
    import socket

    path = Path(endpoint.removeprefix("ipc://"))
    if not endpoint.startswith("ipc://") or not path.exists():
        return
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(0.5)
        try:
            probe.connect(str(path))
        except OSError:
            return
    raise DaemonError(f"another daemon listens on {endpoint}; stop it, or give this one another control.endpoint")
