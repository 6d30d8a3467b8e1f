"""Client of a daemon's control socket."""

from __future__ import annotations

import json
import threading
import time
import uuid
from typing import Any, Self

import zmq

from fringed.control.arguments import checked_timeout
from fringed.control.connection import Connection, check_address
from fringed.errors import NoDaemonError, RefusedError
from fringed.keys import Keys, checked_keys


class ControlClient:
    """One connection to a daemon's control socket; may be used by several threads, one call at a time.

    Args:
        endpoint: of the daemon; timeout_s: longest wait for each response. A missing daemon is known at once,
            or within a second where another machine does not respond.
        keys: for a daemon on another machine.
        retry_refused: a refused key is tried again until the time-out, as it may be authorised a moment later;
            False: an error at once.
    """

    def __init__(
        self, endpoint: str, *, timeout_s: float = 5.0, keys: Keys | None = None, retry_refused: bool = True
    ) -> None:
        self.endpoint, self._timeout_s = endpoint, checked_timeout(timeout_s)
        self._keys: Keys | None = None
        self._retry_refused = retry_refused
        self._lock = threading.Lock()
        self._hint = "start one with `fringed run rig.yaml` or `fringed demo`, or name its address (--endpoint)"
        if endpoint.startswith("tcp://"):
            self._hint += "; a daemon on another machine needs keys, see docs/how-to/remote.md"
        if checked_keys(keys) is not None and not endpoint.startswith("ipc://"):  # ipc stays on this machine
            self._keys = keys
            self._hint = "is it running, does it allow this key, and is that its server key?"
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._connection: Connection | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; may be called twice."""
        self._context.destroy(linger=0)

    def call(self, method: str, /, **params: Any) -> Any:
        """Call a method and return its result.

        Raises:
            NoDaemonError: there is no listener, or no response in time. RefusedError: the daemon's error message.
        """
        request_id = str(uuid.uuid4())
        request = {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}
        with self._lock:
            response = self._exchange(json.dumps(request).encode(), request_id)
        if "error" in response:
            error = response["error"]
            raise RefusedError(
                f"the daemon refused {method}: {error.get('message')}",
                code=error.get("code", 0),
                data=error.get("data"),
            )
        return response.get("result")

    def _exchange(self, request: bytes, request_id: str) -> dict[str, Any]:
        """Send a request and return its response."""
        connection = self._connected()
        connection.socket.send(request)
        start_s, waited_s = time.monotonic(), 0.0
        while waited_s < self._timeout_s:
            if connection.wait(connection.limit_s(self._timeout_s) - waited_s):
                response: dict[str, Any] = json.loads(connection.socket.recv_multipart()[-1])
                if response.get("id") in (request_id, None):
                    return response
            waited_s = time.monotonic() - start_s
            problem = connection.problem(waited_s)
            if problem:
                self._disconnect()
                raise self._no_daemon(problem)
        raise self._no_daemon(f"no response within {self._timeout_s:g} s")

    def _connected(self) -> Connection:
        """The connection, begun with the first call; ZeroMQ restores it when the daemon is restarted."""
        if self._connection is not None:
            return self._connection
        problem = check_address(self.endpoint)
        if problem:
            raise self._no_daemon(problem)
        made = self._context.socket(zmq.DEALER)
        made.setsockopt(zmq.LINGER, 0)
        if self._keys is not None:
            self._keys.apply(made)
        final = self._keys is None or not self._retry_refused
        self._connection = Connection(made, final=final, keyed=final and self._keys is not None)
        try:
            made.connect(self.endpoint)
        except zmq.ZMQError as error:
            self._disconnect()
            raise self._no_daemon(f"that is no address, use ipc://PATH or tcp://HOST:PORT ({error})") from error
        return self._connection

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _no_daemon(self, problem: str) -> NoDaemonError:
        return NoDaemonError(f"no daemon answers at {self.endpoint}: {problem}; {self._hint}")
