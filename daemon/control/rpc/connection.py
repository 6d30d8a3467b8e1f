"""The state of a connection to a daemon: whether there is a listener at its address."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import zmq
from zmq.utils.monitor import recv_monitor_message

CONNECT_S = 0.8
"""Longest time until a connection is accepted, in a millisecond on this machine, by the operating system."""

HANDSHAKE_S = 5.0
"""Longest time until the daemon itself greets, which may take seconds on an overloaded machine."""

_FAILED = zmq.EVENT_CONNECT_RETRIED
_REFUSED = zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_ACCEPTED, _UP = zmq.EVENT_CONNECTED, zmq.EVENT_HANDSHAKE_SUCCEEDED
_DOWN = zmq.EVENT_DISCONNECTED


class Connection:
    """A socket and what becomes of its connecting.

    Args:
        made: not connected yet; final: a refused connection stays refused. With keys it does not: a key that is
            authorised a moment later connects by itself.
    """

    def __init__(self, made: zmq.Socket[bytes], *, final: bool) -> None:
        self.socket = made
        self._final = final
        self._accepted = self._greeted = False
        self._problem = ""
        self._monitor: zmq.Socket[Any] = made.get_monitor_socket(_FAILED | _REFUSED | _ACCEPTED | _UP | _DOWN)
        self._poller = zmq.Poller()
        for one in (made, self._monitor):
            self._poller.register(one, zmq.POLLIN)

    def limit_s(self, timeout_s: float) -> float:
        """How long to wait for the next step: the connection, the daemon's greeting, or its response."""
        if self._greeted or (self._accepted and not self._final):
            return timeout_s
        return min(timeout_s, HANDSHAKE_S if self._accepted else CONNECT_S)

    def problem(self, waited_s: float) -> str:
        """Why there is no connection after this time; empty while there is one or may be one."""
        if self._problem or self._greeted:
            return self._problem
        if not self._accepted and waited_s >= CONNECT_S:
            return f"nothing there accepted a connection within {CONNECT_S:g} s"
        if self._final and waited_s >= HANDSHAKE_S:
            return "what listens there does not greet: a daemon that was stopped, or another program"
        return ""

    def wait(self, seconds: float) -> bool:
        """Wait for a message or a change of the connection; return whether there is a message."""
        ready = dict(self._poller.poll(max(0, round(1000 * seconds))))
        while self._monitor.poll(0):
            self._note(int(recv_monitor_message(self._monitor)["event"]))
        return self.socket in ready

    def close(self) -> None:
        """Close the socket."""
        self.socket.disable_monitor()
        self._monitor.close(linger=0)
        self.socket.close(linger=0)

    def _note(self, event: int) -> None:
        if event == _ACCEPTED:
            self._accepted = True
        elif event == _UP:
            self._greeted = True
        elif self._greeted or (self._accepted and not self._final):  # ZeroMQ connects again by itself
            return
        elif event & _REFUSED:
            self._problem = "what listens there refused the connection"
        elif event == _DOWN:
            self._problem = "what listens there is no control socket of a daemon"
        elif event == _FAILED:
            self._problem = "nothing listens there"


def check_address(endpoint: str) -> str:
    """Why there is no listener at this address, as far as it is known without connecting; empty otherwise."""
    scheme, _, rest = endpoint.partition("://")
    if scheme == "ipc" and rest:
        return _check_socket_file(Path(rest))
    if scheme == "tcp":
        return _check_host(rest.rpartition(":")[0].strip("[]"))
    return ""


def _check_socket_file(path: Path) -> str:
    if path.name.startswith("@"):  # an abstract name has no file
        return ""
    try:
        if not path.is_socket():
            return "there is no such socket" if not path.exists() else "that file is no socket"
        with socket.socket(socket.AF_UNIX) as probe:
            probe.settimeout(CONNECT_S)
            probe.connect(str(path))
    except ConnectionRefusedError:
        return "its daemon has ended and left the socket behind"
    except PermissionError:
        return "this user may not open the socket (a member of its group may)"
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _check_host(host: str) -> str:
    """Resolve the name in a thread of its own, as the system's resolver may take half a minute."""
    found: list[bool] = []

    def resolve() -> None:
        with suppress(OSError, UnicodeError):
            found.append(bool(socket.getaddrinfo(host, None)))

    thread = threading.Thread(target=resolve, daemon=True)
    thread.start()
    thread.join(CONNECT_S)
    return "" if found else f"the host name {host!r} is unknown"
