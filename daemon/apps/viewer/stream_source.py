"""The stream as the viewer reads it: of each topic only the newest message, however slow the reading is."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Any

import zmq

from fringed import wire
from fringed.errors import WireError
from fringed.keys import Keys
from fringed.losses import Losses
from fringed.receiver import Receiver

TOPICS = ("cloud/full", "preview", "status")
_QUEUE = 2  # whole messages; more would only be older images of the same thing


class NewestMessages:
    """Newest message of each topic; one thread only.

    A socket for each topic, so that the large clouds cannot push the others out of the short queues.

    Args:
        endpoint: of the stream, ``tcp://HOST:PORT`` or ``ipc://PATH``; keys: for one on another machine.

    Raises:
        FringedError: an endpoint that cannot be connected to.
    """

    def __init__(self, endpoint: str, topics: tuple[str, ...] = TOPICS, *, keys: Keys | None = None) -> None:
        self.endpoint = endpoint
        self.damaged = self.skipped = 0
        self._losses = Losses()
        self._context: zmq.Context[Any] = zmq.Context()
        self._receivers: dict[str, Receiver] = {}
        self._waiting: dict[str, list[Any]] = {}
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
        """Clouds that never came here, by the gaps in their numbers."""
        return self._losses.count

    def drain(self, timeout_s: float) -> None:
        """Wait for something to come, then keep the newest of each topic and forget what it replaces."""
        self._poller.poll(max(0, round(1000 * timeout_s)))
        for topic, receiver in self._receivers.items():
            while (frames := receiver.take()) is not None:
                self._count(topic, frames)
                self._waiting[topic] = frames

    def newest(self) -> Iterator[wire.Message]:
        """Hand over what is waiting; a message that does not follow the format is counted and passed over."""
        waiting, self._waiting = self._waiting, {}
        for frames in waiting.values():
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
        if topic != "cloud/full":
            return
        self.skipped += topic in self._waiting
        try:
            _, header = wire.decode_header(frames)
        except WireError:
            return
        self._losses.see(header.session, header.seq)
