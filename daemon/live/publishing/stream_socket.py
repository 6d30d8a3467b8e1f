"""The XPUB socket of the stream: topics with subscribers, and retained messages for those who subscribe."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import zmq

from daemon.common.counters import Counters
from daemon.live.publishing.endpoints import bind_all, remove_files
from daemon.live.publishing.messages import Frames

log = logging.getLogger("fringed.stream")

_META = 4  # messages of a burst
_SEND_QUEUE = 4 + _META  # messages, up to 14 MB each, that wait for each subscriber
_MAX_PREFIXES = 256
_MAX_PREFIX_BYTES = 64
_LINGER_MS = 200  # at the end only, so that the last status goes out


class StreamSocket:
    """A bound socket; after its construction it belongs to one thread, but for :meth:`has_subscribers` and counters.

    Args:
        endpoints: to bind; port ``*`` or 0 becomes a free one, see :attr:`endpoints`.
        retained: messages by topic, sent to every new subscriber of the topic; may be replaced by any thread.
        subscribed: called with all prefixes when they change.

    Raises:
        DaemonError: an endpoint that cannot be bound.
    """

    def __init__(
        self,
        endpoints: Iterable[str],
        *,
        retained: Mapping[str, Frames],
        subscribed: Callable[[Collection[bytes]], None],
    ) -> None:
        self.retained, self._subscribed = retained, subscribed
        #: Messages by topic.
        self.sent = Counters()
        #: Why messages of a topic cannot be made.
        self.problems: dict[str, str] = {}
        self._prefixes: set[bytes] = set()
        self._context: zmq.Context[Any] = zmq.Context()
        #: For a poller.
        self.socket = self._context.socket(zmq.XPUB)
        for option, value in _OPTIONS.items():
            self.socket.setsockopt(option, value)
        #: What was bound, with real port numbers.
        self.endpoints: list[str] = []
        try:
            self.endpoints = bind_all(self.socket, endpoints)
        except BaseException:
            self.close()
            raise

    @property
    def prefixes(self) -> tuple[bytes, ...]:
        """What is subscribed to."""
        return tuple(self._prefixes)

    def has_subscribers(self, topic: str) -> bool:
        """Whether a topic has subscribers now."""
        return any(topic.encode().startswith(prefix) for prefix in self.prefixes)

    def serve_subscriptions(self) -> None:
        """Note the subscriptions; send each retained topic at most once, however many subscribe at the same time."""
        requested: set[str] = set()
        while (prefix := self._next_subscription()) is not None:
            requested |= {topic for topic in self.retained if topic.encode().startswith(prefix)}
        for topic in sorted(requested):
            self.send(topic, self.retained[topic])

    def send_if_subscribed(self, topic: str, make: Callable[[], Frames | None]) -> bool:
        """Whether it was sent. A message that cannot be made must not stop the others: the status reports it.

        ``make`` returns None for a message that is left out.
        """
        if not self.has_subscribers(topic):
            return False
        try:
            frames = make()
        except Exception as error:
            if topic not in self.problems:
                log.exception("%s cannot be made", topic)
            self.problems[topic] = str(error)
            return False
        self.problems.pop(topic, None)
        if frames is None:
            return False
        self.send(topic, frames)
        # libzmq may have accepted a subscription during the call: its meta messages come before the next message.
        self.serve_subscriptions()
        return True

    def send(self, topic: str, frames: Frames) -> None:
        """Send a message; never waits."""
        self.socket.send_multipart(frames, zmq.NOBLOCK, copy=False)
        self.sent.add(topic)

    def close(self) -> None:
        """Unbind, and remove the socket files."""
        self.socket.close(linger=_LINGER_MS)
        self._context.term()
        remove_files(self.endpoints)

    def _next_subscription(self) -> bytes | None:
        """The prefix of a new subscription (one without any topic for other messages), None when nothing waits."""
        try:
            message = self.socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None
        prefix = message[1:]
        if message[:1] == b"\0":
            self._prefixes.discard(prefix)
            self._subscribed(self._prefixes)
        elif message[:1] == b"\1" and len(prefix) <= _MAX_PREFIX_BYTES and len(self._prefixes) < _MAX_PREFIXES:
            self._prefixes.add(prefix)
            self._subscribed(self._prefixes)
            return prefix
        return b"\xff"


_OPTIONS = {
    zmq.XPUB_VERBOSE: 1,
    zmq.SNDHWM: _SEND_QUEUE,
    zmq.LINGER: 0,
    zmq.TCP_KEEPALIVE: 1,
    zmq.MAXMSGSIZE: 1024,  # subscriptions are short; a longer message disconnects its sender
}
