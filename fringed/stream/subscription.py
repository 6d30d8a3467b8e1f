"""Subscribe to the clouds of a daemon: ``for cloud in subscribe("tcp://rig:5555"): ...``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

import zmq

from fringed.keys import Keys
from fringed.parts import topic_of
from fringed.stream.cloud_stream import CloudStream, wait_ms
from fringed.stream.received_cloud import ReceivedCloud

DEFAULT_ENDPOINT = "tcp://127.0.0.1:5555"


class Subscription(CloudStream):
    """Iterator over clouds, created by :func:`subscribe`."""

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> ReceivedCloud:
        """Wait for the newest cloud that was not yet returned (or the next one).

        Raises:
            SilenceError: none came within the time-out; another call continues to wait.
            WireError: a message violates the format; another call continues after it.
        """
        deadline_s = self._deadline_s()
        poller = zmq.Poller()
        for socket in self._sockets():
            poller.register(socket, zmq.POLLIN)
        while (cloud := self._take()) is None:
            poller.poll(wait_ms(self._left_s(deadline_s)))
        return cloud

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class AsyncSubscription(CloudStream):
    """Asynchronous iterator over clouds, created by :func:`asubscribe`."""

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> ReceivedCloud:
        """Wait like ``Subscription.__next__``, without blocking the event loop."""
        import zmq.asyncio

        deadline_s = self._deadline_s()
        poller = zmq.asyncio.Poller()
        for socket in self._sockets():
            poller.register(socket, zmq.POLLIN)
        while (cloud := self._take()) is None:
            await poller.poll(wait_ms(self._left_s(deadline_s)))
        return cloud

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


def subscribe(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    topic: str = "cloud/full",
    parts: Iterable[str] | None = None,
    latest: bool = True,
    timeout_s: float | None = None,
    keys: Keys | None = None,
    shared: bool = False,
) -> Subscription:
    """Subscribe to the clouds of a daemon, for ``for`` and ``with``; it connects and reconnects by itself.

    Args:
        endpoint: ``tcp://HOST:PORT`` or ``ipc://PATH``.
        topic: ``cloud/full``, or ``cloud/depth`` for slow networks (points only; needs the package blosc2).
        parts: instead of a topic: what each cloud shall carry, ``xyz`` and any of ``gray``, ``sigma``, ``rgb``,
            ``normals``, ``interpolated``; the daemon computes colour and normals only for those who ask.
        latest: return the newest cloud and skip older ones; False: every cloud, within the limits of the queues.
        timeout_s: longest wait before SilenceError; None = no limit.
        keys: for a daemon on another machine: ``Keys.load("laptop.key", "server.pub")``.
        shared: for ``ipc://PATH``: read the clouds from the daemon's shared memory, which takes less of both programs'
            time than a copy through the socket; :meth:`fringed.Rig.clouds` does so by itself.
    """
    topic = topic if parts is None else topic_of(parts)
    return Subscription(endpoint, topic, latest=latest, timeout_s=timeout_s, keys=keys, shared=shared)


def asubscribe(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    topic: str = "cloud/full",
    parts: Iterable[str] | None = None,
    latest: bool = True,
    timeout_s: float | None = None,
    keys: Keys | None = None,
    shared: bool = False,
) -> AsyncSubscription:
    """Subscribe like :func:`subscribe`, for ``async for`` and ``async with``."""
    topic = topic if parts is None else topic_of(parts)
    return AsyncSubscription(endpoint, topic, latest=latest, timeout_s=timeout_s, keys=keys, shared=shared)
