"""The state of a connection to a daemon: whether there is a listener at its address."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Any

import zmq
from zmq.utils.monitor import recv_monitor_message

from fringed.control.address import form_problem, host_of, host_problem, port_of
from fringed.keys import Keys

CONNECT_S = 0.8
"""Longest time until a connection is accepted, in a millisecond on this machine, by the operating system."""

HANDSHAKE_S = 5.0
"""Longest time until the daemon itself greets, which may take seconds on an overloaded machine."""

KEY_S = 2.0
"""The same for a client whose refused key is an error at once: a daemon leaves a key that it does not allow without a
greeting, so that it connects when it is allowed."""

_FAILED = zmq.EVENT_CONNECT_RETRIED
_REFUSED = zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_ACCEPTED, _UP = zmq.EVENT_CONNECTED, zmq.EVENT_HANDSHAKE_SUCCEEDED
_DOWN = zmq.EVENT_DISCONNECTED


class Connection:
    """A socket and what becomes of its connecting.

    Args:
        made: not connected yet; final: a refused connection stays refused. With keys it does not: a key that is
            authorised a moment later connects by itself.
        keyed: the socket has keys, for the message about a refusal that is final.
    """

    def __init__(self, made: zmq.Socket[bytes], *, final: bool, keyed: bool = False) -> None:
        self.socket = made
        self._final, self._keyed = final, keyed
        self._handshake_s = KEY_S if keyed else HANDSHAKE_S
        self._accepted = self._greeted = False
        self._problem = ""
        self._monitor: zmq.Socket[Any] = made.get_monitor_socket(_FAILED | _REFUSED | _ACCEPTED | _UP | _DOWN)
        self._poller = zmq.Poller()
        for one in (made, self._monitor):
            self._poller.register(one, zmq.POLLIN)

    @property
    def greeted(self) -> bool:
        """Whether the other side has accepted this socket, and its key."""
        return self._greeted

    def limit_s(self, timeout_s: float) -> float:
        """How long to wait for the next step: the connection, the daemon's greeting, or its response."""
        if self._greeted or (self._accepted and not self._final):
            return timeout_s
        return min(timeout_s, self._handshake_s if self._accepted else CONNECT_S)

    def problem(self, waited_s: float) -> str:
        """Why there is no connection after this time; empty while there is one or may be one."""
        if self._problem or self._greeted:
            return self._problem
        if not self._accepted and waited_s >= CONNECT_S:
            return f"nothing there accepted a connection within {CONNECT_S:g} s"
        if self._final and waited_s >= self._handshake_s:
            if self._keyed:
                return "it does not accept this key"
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
        elif self._problem or self._greeted or (self._accepted and not self._final):  # ZeroMQ connects again by itself
            return
        elif event & _REFUSED:
            self._problem = "what listens there refused the connection" + (
                ": its server key is another one, it uses none, or it does not accept this key" if self._keyed else ""
            )
        elif event == _DOWN:
            self._problem = "what listens there is no control socket of a daemon"
        elif event == _FAILED:
            self._problem = "nothing listens there"


def check_address(endpoint: str) -> str:
    """Why there is no listener at this address, as far as it is known without connecting; empty otherwise."""
    if endpoint.startswith("ipc://") and endpoint != "ipc://":
        return _check_socket_file(Path(endpoint.removeprefix("ipc://")))
    return form_problem(endpoint) or host_problem(endpoint)


def handshake_problem(endpoint: str, keys: Keys | None, *, kind: int, timeout_s: float = HANDSHAKE_S) -> str:
    """Why a socket of this kind cannot connect to a valid address; empty when it is accepted.

    Args:
        kind: of ZeroMQ, such as SUB for a stream; keys: for another machine.
    """
    problem = check_address(endpoint)
    if problem:
        return problem
    with zmq.Context() as context:
        made: zmq.Socket[bytes] = context.socket(kind)
        made.setsockopt(zmq.LINGER, 0)
        if keys is not None and not endpoint.startswith("ipc://"):
            keys.apply(made)
        connection = Connection(made, final=True, keyed=keys is not None)
        try:
            made.connect(endpoint)
            start_s = time.monotonic()
            while not connection.greeted and not problem:
                connection.wait(0.05)
                waited_s = time.monotonic() - start_s
                problem = connection.problem(waited_s)
                if waited_s >= timeout_s and not problem:
                    problem = f"no greeting within {timeout_s:g} s"
        finally:
            connection.close()
    return "" if connection.greeted else problem


def listener_problem(endpoint: str) -> str:
    """Why nothing can be received from a valid address: nothing listens there; empty otherwise."""
    if not endpoint.startswith("tcp://"):
        return check_address(endpoint)
    try:
        socket.create_connection((host_of(endpoint), port_of(endpoint)), timeout=CONNECT_S).close()
    except ConnectionRefusedError:
        return "nothing listens there"
    except TimeoutError:
        return f"nothing there accepted a connection within {CONNECT_S:g} s"
    except OSError as error:
        return error.strerror or str(error)
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
