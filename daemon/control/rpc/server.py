"""The control socket: one thread owns a ROUTER and responds; slow requests are executed in the background.

Responses to slow requests may come after those to later ones: their ids distinguish them.
"""

from __future__ import annotations

import logging
import os
import threading
import weakref
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import zmq

from daemon.common.errors import DaemonError
from daemon.common.ipc_endpoints import prepare_ipc, share_ipc
from daemon.control.rpc.background_executor import BackgroundExecutor, Job
from daemon.control.rpc.protocol import BUSY, FAILED, MAX_BYTES, Method, RequestMessage, Role, RpcError

log = logging.getLogger("fringed.control")

_MOST_PARTS = 3
_MOST_WAITING = 256
_CLOSE_S = 3.0


class ControlServer:
    """Responds to JSON-RPC on an endpoint from :meth:`start` to :meth:`close`.

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
            _refuse_if_used(endpoint)
            self._socket.bind(endpoint)
            share_ipc(endpoint)
        except (zmq.ZMQError, OSError, DaemonError) as error:
            self._context.destroy(linger=0)
            if isinstance(error, DaemonError):
                raise
            raise DaemonError(f"control cannot listen on {endpoint}: {error}") from error
        self.endpoint = self._socket.getsockopt(zmq.LAST_ENDPOINT).rstrip(b"\0").decode()  # type: ignore[union-attr]
        self._background = BackgroundExecutor()
        self._outbox: deque[list[bytes]] = deque(maxlen=_MOST_WAITING)
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        weakref.finalize(self, os.close, self._wake_fd)  # not earlier: a job left behind may still write to it
        self._stop = False
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)

    def start(self) -> None:
        """Start to respond."""
        self._background.start()
        self._thread.start()

    def close(self) -> None:
        """Stop responding and remove the socket file."""
        if not self._background.close(_CLOSE_S):
            log.error("control: %s does not return; left behind", self._background.running)
        self._stop = True
        self._wake()
        if self._thread.ident is not None:
            self._thread.join(5.0)
        if not self._thread.is_alive():
            self._context.destroy(linger=200)
        if self.endpoint.startswith("ipc://"):
            Path(self.endpoint.removeprefix("ipc://")).unlink(missing_ok=True)

    def _wake(self) -> None:
        os.eventfd_write(self._wake_fd, 1)

    def _run(self) -> None:
        poller = zmq.Poller()
        poller.register(self._socket, zmq.POLLIN)
        poller.register(self._wake_fd, zmq.POLLIN)
        while not self._stop:
            try:
                ready = dict(poller.poll())
                if self._wake_fd in ready:
                    os.eventfd_read(self._wake_fd)
                self._send_responses()
                if self._socket in ready:
                    self._serve_one(self._socket.recv_multipart(zmq.NOBLOCK))
            except zmq.Again:
                continue
            except zmq.ZMQError as error:
                if error.errno == zmq.ETERM:
                    return
                log.warning("control: %s", error)
            except Exception:
                log.exception("control: a message failed")
        with suppress(zmq.ZMQError):
            self._send_responses()

    def _send_responses(self) -> None:
        """Send the responses of background jobs."""
        while self._outbox:
            self._socket.send_multipart(self._outbox.popleft())

    def _serve_one(self, parts: list[bytes]) -> None:
        """Serve a message of these parts: sender, optionally an empty one (REQ sockets), the JSON text."""
        if not 2 <= len(parts) <= _MOST_PARTS or (len(parts) == _MOST_PARTS and parts[1]):
            log.warning("control: a message of %d parts is not a request", len(parts))
            return
        request, role = RequestMessage(parts[-1]), Role.OPERATE
        if request.slow(self._methods):
            self._submit(parts[:-1], request, role)
        else:
            self._reply(parts[:-1], request.respond(self._methods, role))

    def _reply(self, to: list[bytes], response: bytes | None) -> None:
        if response is not None:
            self._socket.send_multipart([*to, response])

    def _submit(self, to: list[bytes], request: RequestMessage, role: Role) -> None:
        """Execute a request in the background."""

        def send(response: bytes | None) -> None:
            if response is not None:
                self._outbox.append([*to, response])
                self._wake()

        job = Job(
            request.name,
            run=lambda: send(request.respond(self._methods, role)),
            give_up=lambda: send(request.refuse(RpcError(FAILED, "the daemon is stopping"))),
        )
        if not self._background.submit(job):
            busy = f"busy: {self._background.running or 'earlier requests'} must end first; try again later"
            self._reply(to, request.refuse(RpcError(BUSY, busy)))


def _refuse_if_used(endpoint: str) -> None:
    """Raise DaemonError where another daemon listens on an ipc path, which binding would take from it."""
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
