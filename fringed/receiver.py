"""The socket below every subscriber: connects, reconnects, never keeps more than a few messages."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import zmq

from fringed import wire
from fringed.errors import FringedError
from fringed.keys import Keys


class Receiver:
    """Messages of some topics, one thread only. The connection is made, and made again, in the background.

    Args:
        endpoint: of the daemon's stream; topics: prefixes.
        queue: messages that wait here before further ones are lost.
        keys: for a daemon on another machine; a key that is allowed later gets in by itself.

    Raises:
        FringedError: an endpoint that ZeroMQ cannot connect to.
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
        self.endpoint = endpoint
        self._own = context is None
        self._context = context or zmq.Context()
        self.socket = self._context.socket(zmq.SUB)
        for option, value in _OPTIONS.items():
            self.socket.setsockopt(option, value)
        self.socket.setsockopt(zmq.RCVHWM, queue)
        if keys is not None and not endpoint.startswith("ipc://"):  # which is this machine's and plain
            keys.apply(self.socket)
        try:
            for topic in topics:
                self.socket.subscribe(topic)
            self.socket.connect(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise FringedError(
                f"cannot subscribe to {endpoint!r}: {error}; use tcp://HOST:PORT or ipc://PATH"
            ) from None

    def poll(self, timeout_s: float) -> bool:
        """Wait until something is there."""
        return bool(self.socket.poll(max(0, round(1000 * timeout_s))))

    def take(self) -> list[Any] | None:
        """The frames of the next message, or None; does not wait."""
        try:
            return self.socket.recv_multipart(zmq.NOBLOCK, copy=False)
        except zmq.Again:
            return None

    def receive(self, timeout_s: float) -> wire.Message | None:
        """The next message, decoded, or None when none comes in time.

        Raises:
            WireError: a message that does not follow the format; the next call goes on after it.
        """
        frames = self.take() if self.poll(timeout_s) else None
        return None if frames is None else wire.decode(frames)

    def ask_again(self, topic: str) -> None:
        """Subscribe anew, which makes the daemon send what it retains of this topic."""
        self.socket.unsubscribe(topic)
        self.socket.subscribe(topic)

    def close(self) -> None:
        """Let go of the socket; may be called twice."""
        self.socket.close(linger=0)
        if self._own:
            self._context.term()

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


# A dead peer is noticed by the keep-alive of TCP, within seconds. Not by the heartbeats of ZeroMQ: with a short queue
# they end the process of a slow reader (libzmq #3937, "Assertion failed: _input_stopped").
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
