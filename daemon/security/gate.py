"""The process between other machines and the daemon: ``python -m daemon.security.gate FD PARENT``.

Bytes from outside are only read here. It encrypts, so that the measuring does not have to; when it is flooded, its own
memory and descriptors are bounded; when it dies, the daemon goes on measuring and starts another.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import zmq

from daemon.counters import Counters
from daemon.errors import DaemonError
from daemon.security import limits
from daemon.security.allowed import Allowed
from daemon.security.control_gate import ControlGate
from daemon.security.order import Order, Told
from daemon.security.store import KeyStore
from daemon.security.stream_gate import StreamGate
from daemon.security.zap import Gatekeeper
from drivers.remote.spawn import die_with_parent
from fringed.errors import FringedError

log = logging.getLogger("fringed.gate")

_LOOK_S = 0.25  # so soon does a revoked key lose its connection
_TELL_S = 1.0
_MAX_ORDER_BYTES = 1 << 20


class Gate:
    """Both services behind one list of keys; one thread.

    Raises:
        DaemonError: keys that cannot be used, an address that cannot be bound.
    """

    def __init__(self, order: Order) -> None:
        self._order = order
        self._store = KeyStore(Path(order.keys))
        self._seen = self._store.signature()
        self._server, self._allowed = self._store.server(), self._store.allowed()
        self._problem = ""
        self._refused, self._cut = Counters(), Counters()
        self._context: zmq.Context[Any] = zmq.Context(io_threads=2)
        self._keeper = Gatekeeper(self.allowed, self._refused)
        self._zap = self._context.socket(zmq.ROUTER)
        self._zap.bind("inproc://zeromq.zap.01")
        self._stream, self._control = self._open_stream(), self._open_control()
        self._own_descriptors = limits.open_descriptors()
        limits.allow_descriptors(self._own_descriptors + order.connections)
        self._connections = 0

    def allowed(self) -> Allowed:
        """The list as it is now."""
        return self._allowed

    def run(self, link: socket.socket) -> None:
        """Serve until the daemon closes its end of the link."""
        look_s = tell_s = time.monotonic()
        while True:
            poller = zmq.Poller()
            for one in [link, self._zap, *(s for part in self._parts() for s in part.sockets())]:
                poller.register(one, zmq.POLLIN)
            ready = {key for key, _ in poller.poll(100)}
            now_s = time.monotonic()
            if link.fileno() in ready:
                return  # it says nothing after its order: this is its end
            self._answer_zap()
            for part in self._parts():
                part.serve(ready)
            if now_s >= look_s:
                look_s = now_s + _LOOK_S
                self._look_at_keys()
            if now_s >= tell_s:
                tell_s = now_s + _TELL_S
                self._guard_memory()
                link.sendall(msgspec.json.encode(self.told()) + b"\n")

    def told(self) -> Told:
        """How it goes."""
        stream, control = self._stream, self._control
        return Told(
            stream=stream.front.endpoints if stream else [],
            control=control.front.endpoints if control else [],
            keys=len(self._allowed.entries),
            problem=self._problem,
            refused=self._refused.snapshot(),
            accepted=sum(part.front.accepted for part in self._parts()),
            connections=self._connections,
            sent=stream.sent if stream else 0,
            skipped=stream.skipped if stream else 0,
            requests=control.passed if control else 0,
            cut=self._cut.snapshot(),
            memory_mb=limits.memory_bytes() >> 20,
            last=self._keeper.last,
        )

    def close(self) -> None:
        """End everything."""
        self._context.destroy(linger=0)

    def _parts(self) -> list[StreamGate | ControlGate]:
        return [part for part in (self._stream, self._control) if part is not None]

    def _open_stream(self) -> StreamGate | None:
        order = self._order
        if not order.stream:
            return None
        return StreamGate(self._context, order.stream, order.source, server=self._server, refused=self._refused)

    def _open_control(self) -> ControlGate | None:
        order = self._order
        if not order.control:
            return None
        return ControlGate(
            self._context,
            order.control,
            order.target,
            roles=order.roles,
            allowed=self.allowed,
            server=self._server,
            refused=self._refused,
        )

    def _answer_zap(self) -> None:
        while True:
            try:
                frames = self._zap.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            self._zap.send_multipart([frames[0], b"", *self._keeper.reply(frames[2:])])

    def _look_at_keys(self) -> None:
        """Use changed files; a mistake in them changes nothing, and is told."""
        seen = self._store.signature()
        if seen == self._seen:
            return
        self._seen = seen
        try:
            with limits.spare_descriptors():
                server, newer = self._store.server(), self._store.allowed()
        except (DaemonError, FringedError, OSError) as error:
            self._problem = f"the keys are those of before: {error}"
            return
        self._problem = ""
        before, self._allowed = self._allowed, newer
        all_new, self._server = server != self._server, server
        self._cut_off(
            "server_key" if all_new else "revoked",
            [part for part in self._parts() if all_new or before.lost(part.service, newer)],
        )

    def _guard_memory(self) -> None:
        """Begin anew when a flood has filled the memory: what the allocator only keeps is given back first."""
        with limits.spare_descriptors():
            self._connections = max(0, limits.open_descriptors() - self._own_descriptors)
            most = self._order.memory_mb << 20
            if limits.memory_bytes() <= most:
                return
            limits.trim()
            if limits.memory_bytes() > most:
                self._cut_off("memory", self._parts())
                limits.trim()

    def _cut_off(self, reason: str, parts: list[StreamGate | ControlGate]) -> None:
        for part in parts:
            with limits.spare_descriptors():
                part.cut(self._server)
            self._cut.add(f"{part.service}_{reason}")


def main(arguments: list[str]) -> int:
    """Read the order from the link, serve, end with the daemon."""
    descriptor, parent = int(arguments[0]), int(arguments[1])
    for number in (signal.SIGTERM, signal.SIGINT):  # sent to the whole group; it ends with the daemon, not before
        signal.signal(number, signal.SIG_IGN)
    die_with_parent(parent)
    limits.prepare()
    link = socket.socket(fileno=descriptor)
    try:
        gate = Gate(_order(link))
    except (DaemonError, FringedError, OSError, zmq.ZMQError) as error:
        link.sendall(msgspec.json.encode(Told(failed=str(error))) + b"\n")
        return 1
    with suppress(BrokenPipeError, ConnectionResetError):
        gate.run(link)
    gate.close()
    return 0


def _order(link: socket.socket) -> Order:
    text = b""
    while b"\n" not in text and len(text) <= _MAX_ORDER_BYTES:
        more = link.recv(65536)
        if not more:
            break
        text += more
    return msgspec.json.decode(text.partition(b"\n")[0], type=Order)


if __name__ == "__main__":
    os.nice(5)
    sys.exit(main(sys.argv[1:]))
