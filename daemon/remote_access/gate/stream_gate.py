"""The stream for other machines: read once from the daemon, sent encrypted to whoever may view."""

from __future__ import annotations

from typing import Any

import zmq

from daemon.common.counters import Counters
from daemon.keys.authorized_keys import Service
from daemon.remote_access.gate.curve_socket import Front
from fringed.keys import Key

_MAX_PREFIX_BYTES = 64
_QUEUE = 4  # messages of 14 MB
_AT_ONCE = 64
_FRESHEST = frozenset({b"cloud/full", b"cloud/depth", b"preview", b"status"})
"""Topics of which only the newest message is worth sending."""


class StreamGate:
    """Between the daemon's stream (plain, on this machine) and subscribers elsewhere.

    What nobody here subscribes to is not read from the daemon. A slow reader loses messages, never holds up others.
    """

    service: Service = "stream"

    def __init__(
        self, context: zmq.Context[Any], endpoints: list[str], source: str, *, server: Key, refused: Counters
    ) -> None:
        self._context, self._source, self._refused = context, source, refused
        options = {zmq.XPUB_VERBOSE: 1, zmq.SNDHWM: _QUEUE, zmq.MAXMSGSIZE: 4096}
        self.front = Front(context, zmq.XPUB, "stream", endpoints, server=server, options=options, refused=refused)
        self.skipped = self.sent = 0
        self._connect()

    def sockets(self) -> list[zmq.Socket[Any]]:
        """What to wait for."""
        return [self.front.socket, self.front.monitor, self.source]

    def serve(self, ready: set[Any]) -> None:
        """Do what the sockets that are ready ask for."""
        if self.front.monitor in ready:
            self.front.count_handshakes()
        if self.front.socket in ready:
            self._subscriptions()
        if self.source in ready:
            self._messages()

    def cut(self, server: Key) -> None:
        """End every connection, and with it what was subscribed to."""
        self.source.close(linger=0)
        self.front.cut(server)
        self._connect()

    def close(self) -> None:
        """End everything."""
        self.source.close(linger=0)
        self.front.close()

    def _connect(self) -> None:
        self.source: zmq.Socket[Any] = self._context.socket(zmq.XSUB)
        self.source.setsockopt(zmq.LINGER, 0)
        self.source.setsockopt(zmq.RCVHWM, _QUEUE)
        self.source.setsockopt(zmq.RECONNECT_IVL, 50)
        self.source.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
        self.source.connect(self._source)

    def _subscriptions(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                said = self.front.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            if len(said) == 1 and said[0][:1] in (b"\0", b"\1") and len(said[0]) <= 1 + _MAX_PREFIX_BYTES:
                self.source.send(said[0])
            else:
                self._refused.add("stream_request")

    def _messages(self) -> None:
        waiting: list[list[Any]] = []
        places: dict[bytes, int] = {}
        while len(waiting) < _AT_ONCE:
            try:
                frames = self.source.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                break
            topic = frames[0].bytes
            if topic in _FRESHEST and topic in places:
                waiting[places[topic]] = frames
                self.skipped += 1
            else:
                places[topic] = len(waiting)
                waiting.append(frames)
        for frames in waiting:
            self.front.socket.send_multipart(frames, zmq.NOBLOCK, copy=False)
            self.sent += 1
