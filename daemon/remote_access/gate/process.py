"""The process between other machines and the daemon: ``python -m daemon.remote_access.gate.process FD PARENT``.

Bytes from outside are parsed only here. Encryption costs the measuring process nothing; under a flood, this process's
own memory and descriptors are bounded; when it dies, the daemon goes on measuring and starts another.
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
from daemon.keys.authorized_keys import AuthorizedKeys
from daemon.remote_access.gate import resource_limits
from daemon.remote_access.gate.control_gate import ControlGate
from daemon.remote_access.gate.stream_gate import StreamGate
from daemon.remote_access.gate.zap_handler import ZapHandler
from daemon.remote_access.gate_messages import GateConfig, GateStatus, Keyring
from daemon.remote_access.link import Link
from drivers.child_process import die_with_parent

log = logging.getLogger("fringed.gate")

_STATUS_S = 1.0


class Gate:
    """Stream and control behind one list of keys, served by one thread.

    Raises:
        DaemonError: an address that cannot be bound.
    """

    def __init__(self, config: GateConfig, keyring: Keyring) -> None:
        self._config = config
        self._server, self._authorized = keyring.server, keyring.authorized()
        self._refused, self._cut = Counters(), Counters()
        self._context: zmq.Context[Any] = zmq.Context(io_threads=2)
        self._zap_handler = ZapHandler(self.authorized, self._refused)
        self._zap = self._context.socket(zmq.ROUTER)
        self._zap.bind("inproc://zeromq.zap.01")
        self._stream, self._control = self._open_stream(), self._open_control()
        self._memory = resource_limits.Memory()
        self._own_descriptors = resource_limits.open_descriptors()
        resource_limits.allow_descriptors(self._own_descriptors + config.connections)

    def authorized(self) -> AuthorizedKeys:
        """Return the present list of keys."""
        return self._authorized

    def run(self, link: Link) -> None:
        """Serve until the daemon closes its end of the link."""
        status_s = time.monotonic()
        while True:
            poller = zmq.Poller()
            for one in [link.descriptor, self._zap, *(s for part in self._parts() for s in part.sockets())]:
                poller.register(one, zmq.POLLIN)
            ready = {key for key, _ in poller.poll(100)}
            now_s = time.monotonic()
            if link.descriptor in ready:
                message = link.receive()
                if message is None:
                    return
                self._use(msgspec.json.decode(message, type=Keyring))
            self._answer_zap()
            for part in self._parts():
                part.serve(ready)
            if now_s >= status_s:
                status_s = now_s + _STATUS_S
                self._limit_memory()
                link.send(self.status())

    def status(self) -> GateStatus:
        """Return the present status."""
        stream, control = self._stream, self._control
        return GateStatus(
            stream=stream.public.endpoints if stream else [],
            control=control.public.endpoints if control else [],
            refused=self._refused.snapshot(),
            accepted=sum(part.public.accepted for part in self._parts()),
            connections=max(0, resource_limits.open_descriptors() - self._own_descriptors),
            sent=stream.sent if stream else 0,
            skipped=stream.skipped if stream else 0,
            requests=control.forwarded if control else 0,
            cut=self._cut.snapshot(),
            memory_mb=self._memory.bytes() >> 20,
            last=self._zap_handler.last,
        )

    def close(self) -> None:
        """Close all sockets."""
        self._context.destroy(linger=0)

    def _parts(self) -> list[StreamGate | ControlGate]:
        return [part for part in (self._stream, self._control) if part is not None]

    def _open_stream(self) -> StreamGate | None:
        config = self._config
        if not config.stream:
            return None
        return StreamGate(self._context, config.stream, config.source, server=self._server, refused=self._refused)

    def _open_control(self) -> ControlGate | None:
        config = self._config
        if not config.control:
            return None
        return ControlGate(
            self._context,
            config.control,
            config.target,
            roles=config.roles,
            authorized=self.authorized,
            server=self._server,
            refused=self._refused,
        )

    def _answer_zap(self) -> None:
        while True:
            try:
                frames = self._zap.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            self._zap.send_multipart([frames[0], b"", *self._zap_handler.reply(frames[2:])])

    def _use(self, keyring: Keyring) -> None:
        """Use other keys; where one lost its access, all clients are disconnected: ZeroMQ cannot end a single one."""
        before, self._authorized = self._authorized, keyring.authorized()
        renewed, self._server = keyring.server != self._server, keyring.server
        lost = [part for part in self._parts() if renewed or before.lost(part.service, self._authorized)]
        self._disconnect("server_key" if renewed else "revoked", lost)

    def _limit_memory(self) -> None:
        """Disconnect all clients when a flood has filled the memory; free memory is returned to the kernel first."""
        most = self._config.memory_mb << 20
        if self._memory.bytes() <= most:
            return
        resource_limits.trim()
        if self._memory.bytes() > most:
            self._disconnect("memory", self._parts())
            resource_limits.trim()

    def _disconnect(self, reason: str, parts: list[StreamGate | ControlGate]) -> None:
        for part in parts:
            with resource_limits.spare_descriptors():
                part.cut(self._server)
            self._cut.add(f"{part.service}_{reason}")


def main(arguments: list[str]) -> int:
    """Read the configuration from the link, serve, end with the daemon."""
    descriptor, parent = int(arguments[0]), int(arguments[1])
    for number in (signal.SIGTERM, signal.SIGINT):  # sent to the whole group; this process ends with the daemon
        signal.signal(number, signal.SIG_IGN)
    die_with_parent(parent)
    resource_limits.prepare()
    link = Link(socket.socket(fileno=descriptor))
    config, keyring = link.receive(), link.receive()
    if config is None or keyring is None:
        return 1
    try:
        gate = Gate(msgspec.json.decode(config, type=GateConfig), msgspec.json.decode(keyring, type=Keyring))
    except (DaemonError, OSError, zmq.ZMQError) as error:
        link.send(GateStatus(failed=str(error)))
        return 1
    with suppress(BrokenPipeError, ConnectionResetError):
        gate.run(link)
    gate.close()
    return 0


if __name__ == "__main__":
    with suppress(OSError):
        os.nice(5)
    sys.exit(main(sys.argv[1:]))
