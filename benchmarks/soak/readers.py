"""Subscribers of a soak run, which receive every message at once and decode only its header."""

from __future__ import annotations

import time

import zmq

from fringed import wire
from fringed.stream.losses import Losses
from fringed.stream.receiver import Receiver

_QUEUE = 8


class Reader:
    """One subscriber of one topic of clouds.

    ``received`` counts messages, ``losses`` the gaps in their numbers; ``latencies_ms`` are from the start of exposure
    to here.
    """

    def __init__(self, endpoint: str, topic: str) -> None:
        self.topic = topic
        self.receiver = Receiver(endpoint, [topic], queue=_QUEUE)
        self.received, self.losses = 0, Losses()
        self.latencies_ms: list[float] = []

    def drain(self) -> None:
        """Receive all waiting messages."""
        while (frames := self.receiver.take()) is not None:
            _, header = wire.decode_header(frames)
            self.received += 1
            self.losses.add(header.session, header.seq)
            self.latencies_ms.append((time.time_ns() - header.t_ns) / 1e6)

    def forget(self) -> None:
        """Count from now on."""
        self.received, self.losses = 0, Losses()
        self.latencies_ms.clear()


class Readers:
    """Several readers, served by the caller of :meth:`serve`."""

    def __init__(self, endpoint: str, topics: tuple[str, ...]) -> None:
        self.all = [Reader(endpoint, topic) for topic in topics]
        self._poller = zmq.Poller()
        for reader in self.all:
            self._poller.register(reader.receiver.socket, zmq.POLLIN)

    def serve(self, seconds: float) -> None:
        """Take messages for so long."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            self._poller.poll(max(1, round(1e3 * left_s)))
            for reader in self.all:
                reader.drain()

    def forget(self) -> None:
        """Count from now on."""
        for reader in self.all:
            reader.forget()

    def close(self) -> None:
        """Disconnect."""
        for reader in self.all:
            reader.receiver.close()
