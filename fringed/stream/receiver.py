"""The socket of every subscriber: connects, reconnects, and keeps few messages."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import zmq

from fringed import wire
from fringed.control.address import checked_endpoint
from fringed.errors import ArgumentError
from fringed.keys import Keys, checked_keys


class Receiver:
    """Receives messages of some topics in one thread; connects and reconnects in the background.

    Args:
        endpoint: of the daemon's stream; topics: prefixes.
        queue: messages that wait here before further ones are lost.
        keys: for a daemon on another machine; a key that is authorised later connects by itself.

    Raises:
        ArgumentError: an endpoint of another form, with an unknown host, or keys of another type.
    """

    def __init__(
        self,
        endpoint: str,
        topics: Iterable[str],
        *,
        queue: int = 2,
        context: zmq.Context[Any] | None = None,
        keys: Keys | None = None,
    ) -> None:
        self.endpoint = checked_endpoint(endpoint)
        checked_keys(keys)
        self._own = context is None
        self._context = context or zmq.Context()
        self.socket = self._context.socket(zmq.SUB)
        for option, value in _OPTIONS.items():
            self.socket.setsockopt(option, value)
        self.socket.setsockopt(zmq.RCVHWM, queue)
        if keys is not None and not endpoint.startswith("ipc://"):  # ipc stays on this machine and needs no keys
            keys.apply(self.socket)
        try:
            for topic in topics:
                self.socket.subscribe(topic)
            self.socket.connect(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise ArgumentError(
                f"cannot subscribe to {endpoint!r}: {error}; use tcp://HOST:PORT or ipc://PATH"
            ) from None

    def poll(self, timeout_s: float) -> bool:
        """Wait for a message; return whether there is one."""
        return bool(self.socket.poll(max(0, round(1000 * timeout_s))))

    def take(self) -> list[Any] | None:
        """Return the frames of the next message, or None; does not wait."""
        try:
            return self.socket.recv_multipart(zmq.NOBLOCK, copy=False)
        except zmq.Again:
            return None

    def receive(self, timeout_s: float) -> wire.Message | None:
        """Return the next message, decoded, or None when none comes in time.

        Raises:
            WireError: a message violates the format; the next call continues after it.
        """
        frames = self.take() if self.poll(timeout_s) else None
        return None if frames is None else wire.decode(frames)

    def request_again(self, topic: str) -> None:
        """Subscribe again, upon which the daemon sends the retained message of this topic."""
        self.socket.unsubscribe(topic)
        self.socket.subscribe(topic)

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self.socket.close(linger=0)
        if self._own:
            self._context.term()

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


# TCP keep-alive detects a dead peer within seconds. ZeroMQ's heartbeats are not used: with a short queue they end the
# process of a slow reader (libzmq #3937, "Assertion failed: _input_stopped").
_OPTIONS = {
    zmq.LINGER: 0,
    zmq.TCP_KEEPALIVE: 1,
    zmq.TCP_KEEPALIVE_IDLE: 3,
    zmq.TCP_KEEPALIVE_INTVL: 1,
    zmq.TCP_KEEPALIVE_CNT: 3,
    zmq.RECONNECT_IVL: 50,
    zmq.RECONNECT_IVL_MAX: 1000,
    zmq.MAXMSGSIZE: wire.MAX_PART_BYTES,
    zmq.IPV6: 1,
}
