"""``GET /metrics`` on 127.0.0.1: one thread, few connections, short requests; slow clients are disconnected."""

from __future__ import annotations

import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from daemon.common.errors import DaemonError

log = logging.getLogger("fringed.health")

MOST_CONNECTIONS, MAX_REQUEST, TIMEOUT_S = 8, 4096, 2.0
_TICK_S = 0.25
_KIND = "text/plain; version=0.0.4; charset=utf-8"


@dataclass(slots=True, eq=False)
class _Connection:
    socket: socket.socket
    until_s: float
    request: bytes = b""
    rest: bytes = field(default=b"")


class MetricsServer:
    """Serves requests from construction on.

    Args:
        port: at 127.0.0.1, 0 = a free one; text: returns the page.

    Raises:
        DaemonError: the port is taken.
    """

    def __init__(self, port: int, text: Callable[[], str]) -> None:
        self._text = text
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(("127.0.0.1", port))
            self._listener.listen(MOST_CONNECTIONS)
        except OSError as error:
            self._listener.close()
            message = f"health.metrics_port {port} is not available: {error.strerror or error}; choose another, or null"
            raise DaemonError(message) from error
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}/metrics"
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._connections: dict[socket.socket, _Connection] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._stop.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                for key, _ in self._selector.select(_TICK_S):
                    self._serve(key.fileobj)
                self._drop_slow()
        except Exception:
            log.exception("the metrics server failed")
        finally:
            for connection in list(self._connections.values()):
                self._drop(connection)
            self._selector.close()
            self._listener.close()

    def _serve(self, ready: object) -> None:
        if ready is self._listener:
            self._accept()
            return
        connection = self._connections.get(ready)  # type: ignore[call-overload]
        if connection is None:
            return
        try:
            self._send(connection) if connection.rest else self._receive(connection)
        except OSError:
            self._drop(connection)

    def _accept(self) -> None:
        with suppress(OSError):
            accepted, _ = self._listener.accept()
            if len(self._connections) >= MOST_CONNECTIONS:
                accepted.close()
                return
            accepted.setblocking(False)
            self._connections[accepted] = _Connection(accepted, time.monotonic() + TIMEOUT_S)
            self._selector.register(accepted, selectors.EVENT_READ)

    def _receive(self, connection: _Connection) -> None:
        part = connection.socket.recv(MAX_REQUEST)
        connection.request += part
        if not part:
            self._drop(connection)
        elif b"\r\n\r\n" in connection.request or b"\n\n" in connection.request:
            connection.rest = self._answer(connection.request)
            self._selector.modify(connection.socket, selectors.EVENT_WRITE)
        elif len(connection.request) > MAX_REQUEST:
            connection.rest = _response("431 Request Header Fields Too Large", b"too long\n")
            self._selector.modify(connection.socket, selectors.EVENT_WRITE)

    def _answer(self, request: bytes) -> bytes:
        parts = request.split(b"\n", 1)[0].split()
        if len(parts) != 3 or not parts[2].startswith(b"HTTP/1."):
            return _response("400 Bad Request", b"not HTTP\n")
        if parts[0] not in (b"GET", b"HEAD"):
            return _response("405 Method Not Allowed", b"only GET\n")
        if parts[1].partition(b"?")[0] != b"/metrics":
            return _response("404 Not Found", b"there is only /metrics\n")
        try:
            page = self._text().encode()
        except Exception:
            log.exception("the metrics cannot be generated")
            return _response("500 Internal Server Error", b"see the log\n")
        return _response("200 OK", page, head=parts[0] == b"HEAD")

    def _send(self, connection: _Connection) -> None:
        connection.rest = connection.rest[connection.socket.send(connection.rest) :]
        if not connection.rest:
            self._drop(connection)

    def _drop_slow(self) -> None:
        now_s = time.monotonic()
        for connection in [one for one in self._connections.values() if one.until_s < now_s]:
            self._drop(connection)

    def _drop(self, connection: _Connection) -> None:
        self._connections.pop(connection.socket, None)
        with suppress(KeyError, ValueError):
            self._selector.unregister(connection.socket)
        with suppress(OSError):
            connection.socket.shutdown(socket.SHUT_WR)
        connection.socket.close()


def _response(status: str, body: bytes, *, head: bool = False) -> bytes:
    lines = f"HTTP/1.1 {status}\r\nContent-Type: {_KIND}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return lines.encode() + (b"" if head else body)
