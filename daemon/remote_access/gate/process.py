"""The process between other machines and the daemon: ``python -m daemon.remote_access.gate.process FD PARENT``.

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
from typing import Any

import msgspec
import zmq

from daemon.common.counters import Counters
from daemon.common.errors import DaemonError
from daemon.keys.authorized_keys import Allowed
from daemon.remote_access.gate import resource_limits
from daemon.remote_access.gate.control_gate import ControlGate
from daemon.remote_access.gate.stream_gate import StreamGate
from daemon.remote_access.gate.zap_handler import Gatekeeper
from daemon.remote_access.gate_messages import Keyring, Order, Told
from daemon.remote_access.link import Link
from drivers.child_process import die_with_parent

log = logging.getLogger("fringed.gate")

_TELL_S = 1.0


class Gate:
    """Both services behind one list of keys; one thread.

    Raises:
        DaemonError: an address that cannot be bound.
    """

    def __init__(self, order: Order, keyring: Keyring) -> None:
        self._order = order
        self._server, self._allowed = keyring.server, keyring.allowed()
        self._refused, self._cut = Counters(), Counters()
        self._context: zmq.Context[Any] = zmq.Context(io_threads=2)
        self._keeper = Gatekeeper(self.allowed, self._refused)
        self._zap = self._context.socket(zmq.ROUTER)
        self._zap.bind("inproc://zeromq.zap.01")
        self._stream, self._control = self._open_stream(), self._open_control()
        self._memory = resource_limits.Memory()
        self._own_descriptors = resource_limits.open_descriptors()
        resource_limits.allow_descriptors(self._own_descriptors + order.connections)

    def allowed(self) -> Allowed:
        """The list as it is now."""
        return self._allowed

    def run(self, link: Link) -> None:
        """Serve until the daemon closes its end of the link."""
        tell_s = time.monotonic()
        while True:
            poller = zmq.Poller()
            for one in [link.descriptor, self._zap, *(s for part in self._parts() for s in part.sockets())]:
                poller.register(one, zmq.POLLIN)
            ready = {key for key, _ in poller.poll(100)}
            now_s = time.monotonic()
            if link.descriptor in ready:
                word = link.next()
                if word is None:
                    return
                self._use(msgspec.json.decode(word, type=Keyring))
            self._answer_zap()
            for part in self._parts():
                part.serve(ready)
            if now_s >= tell_s:
                tell_s = now_s + _TELL_S
                self._guard_memory()
                link.say(self.told())

    def told(self) -> Told:
        """How it goes."""
        stream, control = self._stream, self._control
        return Told(
            stream=stream.front.endpoints if stream else [],
            control=control.front.endpoints if control else [],
            refused=self._refused.snapshot(),
            accepted=sum(part.front.accepted for part in self._parts()),
            connections=max(0, resource_limits.open_descriptors() - self._own_descriptors),
            sent=stream.sent if stream else 0,
            skipped=stream.skipped if stream else 0,
            requests=control.passed if control else 0,
            cut=self._cut.snapshot(),
            memory_mb=self._memory.bytes() >> 20,
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

    def _use(self, keyring: Keyring) -> None:
        """Other keys from now on; who may connect no more is cut off, which ZeroMQ can only do to all at once."""
        before, self._allowed = self._allowed, keyring.allowed()
        renewed, self._server = keyring.server != self._server, keyring.server
        lost = [part for part in self._parts() if renewed or before.lost(part.service, self._allowed)]
        self._cut_off("server_key" if renewed else "revoked", lost)

    def _guard_memory(self) -> None:
        """Begin anew when a flood has filled the memory: what the allocator only keeps is given back first."""
        most = self._order.memory_mb << 20
        if self._memory.bytes() <= most:
            return
        resource_limits.trim()
        if self._memory.bytes() > most:
            self._cut_off("memory", self._parts())
            resource_limits.trim()

    def _cut_off(self, reason: str, parts: list[StreamGate | ControlGate]) -> None:
        for part in parts:
            with resource_limits.spare_descriptors():
                part.cut(self._server)
            self._cut.add(f"{part.service}_{reason}")


def main(arguments: list[str]) -> int:
    """Read the order from the link, serve, end with the daemon."""
    descriptor, parent = int(arguments[0]), int(arguments[1])
    for number in (signal.SIGTERM, signal.SIGINT):  # sent to the whole group; it ends with the daemon, not before
        signal.signal(number, signal.SIG_IGN)
    die_with_parent(parent)
    resource_limits.prepare()
    link = Link(socket.socket(fileno=descriptor))
    words = link.next(), link.next()
    if None in words:
        return 1
    try:
        gate = Gate(
            msgspec.json.decode(words[0] or b"", type=Order), msgspec.json.decode(words[1] or b"", type=Keyring)
        )
    except (DaemonError, OSError, zmq.ZMQError) as error:
        link.say(Told(failed=str(error)))
        return 1
    with suppress(BrokenPipeError, ConnectionResetError):
        gate.run(link)
    gate.close()
    return 0


if __name__ == "__main__":
    with suppress(OSError):
        os.nice(5)
    sys.exit(main(sys.argv[1:]))
