"""The stream for other machines: read once from the daemon, sent encrypted to authorised subscribers."""

from __future__ import annotations

from typing import Any

import zmq

from daemon.common.counters import Counters
from daemon.keys.authorized_keys import Service
from daemon.remote_access.gate.curve_socket import CurveSocket
from fringed.keys import Key

_MAX_PREFIX_BYTES = 64
_QUEUE = 8  # messages, up to 14 MB each: the four meta messages beside clouds
_AT_ONCE = 64
_LOCAL = b"cloud/shared/"  # refers to memory of this machine
_LATEST_ONLY = frozenset({b"preview", b"status"})
"""Topics of which only the newest waiting message is sent; those of clouds too."""


class StreamGate:
    """Relays between the daemon's stream (plain, on this machine) and subscribers on other machines.

    Topics without a subscriber are not read from the daemon. A slow reader loses messages and never delays others.
    """

    service: Service = "stream"

    def __init__(
        self, context: zmq.Context[Any], endpoints: list[str], source: str, *, server: Key, refused: Counters
    ) -> None:
        self._context, self._source, self._refused = context, source, refused
        options = {zmq.XPUB_VERBOSE: 1, zmq.SNDHWM: _QUEUE, zmq.MAXMSGSIZE: 4096}
        self.public = CurveSocket(
            context, zmq.XPUB, "stream", endpoints, server=server, options=options, refused=refused
        )
        self.skipped = self.sent = 0
        self._connect()

    def sockets(self) -> list[zmq.Socket[Any]]:
        """Return the sockets to poll."""
        return [self.public.socket, self.public.monitor, self.source]

    def serve(self, ready: set[Any]) -> None:
        """Serve the sockets that are ready."""
        if self.public.monitor in ready:
            self.public.count_handshakes()
        if self.public.socket in ready:
            self._subscriptions()
        if self.source in ready:
            self._messages()

    def cut(self, server: Key) -> None:
        """End every connection and with it every subscription."""
        self.source.close(linger=0)
        self.public.cut(server)
        self._connect()

    def close(self) -> None:
        """Close all sockets."""
        self.source.close(linger=0)
        self.public.close()

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
                frames = self.public.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            valid = len(frames) == 1 and frames[0][:1] in (b"\0", b"\1") and len(frames[0]) <= 1 + _MAX_PREFIX_BYTES
            if valid and not frames[0][1:].startswith(_LOCAL):
                self.source.send(frames[0])
            else:
                self._refused.add("stream_request")

    def _messages(self) -> None:
        waiting: list[list[Any]] = []
        positions: dict[bytes, int] = {}
        while len(waiting) < _AT_ONCE:
            try:
                frames = self.source.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                break
            topic = frames[0].bytes
            if topic in positions and (topic in _LATEST_ONLY or topic.startswith(b"cloud/")):
                waiting[positions[topic]] = frames
                self.skipped += 1
            else:
                positions[topic] = len(waiting)
                waiting.append(frames)
        for frames in waiting:
            self.public.socket.send_multipart(frames, zmq.NOBLOCK, copy=False)
            self.sent += 1
