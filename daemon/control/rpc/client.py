"""Client of a daemon's control socket."""

from __future__ import annotations

import json
import uuid
from typing import Any, Self

import zmq

from daemon.common.errors import ControlError
from fringed.keys import Keys


class ControlClient:
    """One connection to a daemon's control socket.

    Args:
        endpoint: of the daemon; timeout_s: longest wait for each response.
        keys: for a daemon on another machine.
    """

    def __init__(self, endpoint: str, *, timeout_s: float = 5.0, keys: Keys | None = None) -> None:
        self.endpoint, self._timeout_s = endpoint, timeout_s
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._hint = "start one with `fringed run rig.yaml`, or name its control endpoint"
        if endpoint.startswith("tcp://"):
            self._hint += "; a daemon on another machine needs keys, see docs/remote.md"
        if keys is not None and not endpoint.startswith("ipc://"):  # ipc stays on this machine and needs no keys
            keys.apply(self._socket)
            self._hint = "is it running, does it allow this key, and is that its server key?"
        try:
            self._socket.connect(endpoint)
        except zmq.ZMQError as error:
            self._context.destroy(linger=0)
            raise ControlError(f"{endpoint} is not an address of a daemon: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._context.destroy(linger=0)

    def call(self, method: str, /, **params: Any) -> Any:
        """Call a method and return its result.

        Raises:
            ControlError: no response in time, or the daemon's error message.
        """
        request_id = str(uuid.uuid4())
        request = {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}
        self._socket.send(json.dumps(request).encode())
        while self._socket.poll(round(1000 * self._timeout_s)):
            response = json.loads(self._socket.recv_multipart()[-1])
            if response.get("id") not in (request_id, None):
                continue  # a late response to an earlier request
            if "error" in response:
                raise ControlError(f"the daemon refused {method}: {response['error'].get('message')}")
            return response.get("result")
        raise ControlError(f"no daemon answers at {self.endpoint}; {self._hint}")
