"""The viewer's subscription: only the newest message of each topic, independent of the reading speed."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Any

import zmq

from fringed import wire
from fringed.errors import WireError
from fringed.keys import Keys
from fringed.parts import BASIC, topic_of
from fringed.stream.losses import Losses
from fringed.stream.receiver import Receiver

TOPICS = ("cloud/full", "preview", "status")
COLOR_TOPIC = topic_of((*BASIC, "rgb"))
"""Instead of ``cloud/full`` where colour is shown."""
_QUEUE = 2  # complete messages; a longer queue would only delay them


class NewestMessages:
    """The newest message of each topic, for one thread.

    A socket for each topic, so that large clouds cannot displace the others in the short queues.

    Args:
        endpoint: of the stream, ``tcp://HOST:PORT`` or ``ipc://PATH``; keys: for one on another machine.

    Raises:
        FringedError: an invalid endpoint.
    """

    def __init__(self, endpoint: str, topics: tuple[str, ...] = TOPICS, *, keys: Keys | None = None) -> None:
        self.endpoint = endpoint
        self.damaged = self.skipped = 0
        self._losses = Losses()
        self._context: zmq.Context[Any] = zmq.Context()
        self._receivers: dict[str, Receiver] = {}
        self._pending: dict[str, list[Any]] = {}
        self._poller = zmq.Poller()
        try:
            for topic in topics:
                self._receivers[topic] = Receiver(endpoint, [topic], queue=_QUEUE, context=self._context, keys=keys)
                self._poller.register(self._receivers[topic].socket, zmq.POLLIN)
        except BaseException:
            self.close()
            raise

    @property
    def lost(self) -> int:
        """Clouds that did not arrive, from the gaps in their numbers."""
        return self._losses.count

    def drain(self, timeout_s: float) -> None:
        """Wait for messages, then keep the newest one of each topic."""
        self._poller.poll(max(0, round(1000 * timeout_s)))
        for topic, receiver in self._receivers.items():
            while (frames := receiver.take()) is not None:
                self._count(topic, frames)
                self._pending[topic] = frames

    def newest(self) -> Iterator[wire.Message]:
        """Yield the pending messages; invalid ones are counted and left out."""
        pending, self._pending = self._pending, {}
        for frames in pending.values():
            try:
                yield wire.decode(frames)
            except WireError:
                self.damaged += 1

    def close(self) -> None:
        """Disconnect."""
        for receiver in self._receivers.values():
            receiver.close()
        self._context.term()

    def __enter__(self) -> NewestMessages:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _count(self, topic: str, frames: list[Any]) -> None:
        if not topic.startswith("cloud/"):
            return
        self.skipped += topic in self._pending
        try:
            _, header = wire.decode_header(frames)
        except WireError:
            return
        self._losses.add(header.session, header.seq)
