"""A CURVE server socket that only authorised keys reach, with a count of failed handshakes."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

import zmq
from zmq.utils.monitor import recv_monitor_message

from daemon.common.counters import Counters
from daemon.common.errors import DaemonError
from daemon.keys.authorized_keys import Service
from fringed.keys import Key

_HANDSHAKE_MS = 5000  # a client that has not sent a key by then is disconnected
_REBIND_S = 20.0
_FAILED = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_EVENTS_AT_ONCE = 256


Options = dict[zmq.SocketOption, int]


class CurveSocket:
    """Binds, counts handshakes, and can disconnect all clients by binding the same addresses again.

    Args:
        kind: of the socket; service: the ZAP domain; options: of the socket.
    """

    def __init__(
        self,
        context: zmq.Context[Any],
        kind: int,
        service: Service,
        endpoints: list[str],
        *,
        server: Key,
        options: Options,
        refused: Counters,
    ) -> None:
        self._context, self._kind, self._service = context, kind, service
        self._options, self._refused = options, refused
        self.endpoints = endpoints
        self.accepted = 0
        self._open(server, 0.0)

    def cut(self, server: Key) -> None:
        """End every connection; authorised clients reconnect by themselves."""
        self.close()
        self._open(server, _REBIND_S)

    def close(self) -> None:
        """End every connection."""
        self.socket.disable_monitor()
        self.monitor.close(linger=0)
        self.socket.close(linger=0)

    def count_handshakes(self) -> None:
        """Count the monitor's handshake events; keys that are not authorised are counted where they are refused."""
        for _ in range(_EVENTS_AT_ONCE):
            try:
                event = recv_monitor_message(self.monitor, zmq.NOBLOCK)["event"]
            except zmq.Again:
                return
            if event & _FAILED:
                self._refused.add(f"{self._service}_handshake")
            elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self.accepted += 1

    def _open(self, server: Key, timeout_s: float) -> None:
        self.socket: zmq.Socket[Any] = self._context.socket(self._kind)
        # Only where needed: IPv4 addresses would be reported in the form of IPv6.
        ipv6 = {zmq.IPV6: int(any("[" in endpoint for endpoint in self.endpoints))}
        for option, value in (_DEFAULTS | ipv6 | self._options).items():
            self.socket.setsockopt(option, value)
        self.socket.setsockopt(zmq.CURVE_SERVER, 1)
        self.socket.setsockopt(zmq.CURVE_SECRETKEY, str(server.secret).encode())
        self.socket.setsockopt(zmq.ZAP_DOMAIN, self._service.encode())
        # Without this the ZAP reply of an empty domain is requested and ignored: any key would be accepted.
        self.socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        self.monitor = self.socket.get_monitor_socket(_FAILED | zmq.EVENT_HANDSHAKE_SUCCEEDED)
        try:
            self.endpoints = [self._bind(endpoint, timeout_s) for endpoint in self.endpoints]
        except BaseException:
            self.close()
            raise

    def _bind(self, endpoint: str, timeout_s: float) -> str:
        """Bind an address and return it with its real port; ZeroMQ may still be closing its earlier socket there."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            with suppress(zmq.Again):
                try:
                    self.socket.bind(endpoint)
                    bound: bytes = self.socket.getsockopt(zmq.LAST_ENDPOINT)  # type: ignore[assignment]
                    return bound.rstrip(b"\0").decode()
                except zmq.ZMQError as error:
                    if error.errno != zmq.EADDRINUSE or time.monotonic() >= deadline_s:
                        raise DaemonError(
                            f"{self._service}: cannot bind {endpoint}: {error}; stop what uses it, or change rig.yaml"
                        ) from error
            time.sleep(0.02)


_DEFAULTS: Options = {
    zmq.LINGER: 0,
    zmq.HANDSHAKE_IVL: _HANDSHAKE_MS,
    zmq.BACKLOG: 64,
    zmq.TCP_KEEPALIVE: 1,
    zmq.TCP_KEEPALIVE_IDLE: 10,
    zmq.TCP_KEEPALIVE_INTVL: 5,
    zmq.TCP_KEEPALIVE_CNT: 3,
}
