"""``fringed.Rig``: a running daemon."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import zmq

from fringed.control.address import checked_endpoint, found_control_endpoint, host_of, port_of
from fringed.control.arguments import checked_timeout
from fringed.control.client import ControlClient
from fringed.control.connection import handshake_problem
from fringed.errors import NoDaemonError
from fringed.keys import Keys, loaded_keys
from fringed.parts import topic_of
from fringed.rig.preview import PreviewStream
from fringed.rig.source import TIMEOUT_S, Source
from fringed.stream.subscription import AsyncSubscription, Subscription

CONTROL_PORT = 5558
"""Of the examples in docs/how-to/security.md, for an address without a port."""

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_EVERY_HOST = ("0.0.0.0", "::", "*")  # noqa: S104 - compared, not bound


class CloudStream(Subscription, AsyncSubscription):
    """Clouds of a daemon, for ``for`` and for ``async for``."""


class Rig(Source):
    """A running daemon: clouds, status, settings, takes.

        with fringed.Rig() as rig:
            for cloud in rig.clouds():
                print(cloud.header.seq, cloud.points.shape)

    Args:
        address: of the daemon's **control**: None for the daemon of this machine, ``ipc://PATH``, ``tcp://HOST:PORT``,
            ``HOST:PORT``, or ``HOST`` for port 5558.
        stream: address of the stream; None asks the daemon for it.
        key: for a daemon on another machine: the file ``NAME.key``, or Keys; server_key: its file ``server.pub``.
        timeout_s: longest wait for an answer.

    Raises:
        ArgumentError, KeyFileError: an argument cannot be used.
        NoDaemonError: nothing answers there, or it refuses the key; within about a second.
    """

    def __init__(
        self,
        address: str | None = None,
        *,
        stream: str | None = None,
        key: Keys | str | Path | None = None,
        server_key: str | Path | None = None,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self.address = _control_address(address)
        self._keys = loaded_keys(key, server_key)
        timeout_s = checked_timeout(timeout_s)
        given = None if stream is None else checked_endpoint(stream, name="stream")
        self._client = ControlClient(self.address, timeout_s=timeout_s, keys=self._keys, retry_refused=False)
        try:
            hello = self._client.call("hello") if given is None or given.startswith("ipc://") else {}
            #: Address of the stream.
            self.stream: str = self._checked_stream([given] if given is not None else self._offered(hello))
            # A daemon of an earlier version has no such topics; an address that it does not name is another daemon's.
            self._shared = (
                self.stream.startswith("ipc://") and self.stream in hello["stream"] and bool(hello.get("shared"))
            )
        except BaseException:
            self.close()
            raise

    def __repr__(self) -> str:
        return f"fringed.Rig({self.address!r}, stream={self.stream!r})"

    def clouds(
        self,
        *,
        topic: str = "cloud/full",
        parts: Iterable[str] | None = None,
        latest: bool = True,
        timeout_s: float | None = TIMEOUT_S,
    ) -> CloudStream:
        """Subscribe to the clouds, see :meth:`Source.clouds`; from shared memory where the daemon offers it."""
        topic = topic if parts is None else topic_of(parts)
        shared = None if self._shared and topic != "cloud/depth" else False
        return CloudStream(self.stream, topic, latest=latest, timeout_s=timeout_s, keys=self._keys, shared=shared)

    def previews(self, *, timeout_s: float | None = TIMEOUT_S) -> PreviewStream:
        """Subscribe to the previews, see :meth:`Source.previews`."""
        return PreviewStream(self.stream, timeout_s=timeout_s, keys=self._keys)

    def call(self, method: str, /, **params: Any) -> Any:
        """Call a method of the protocol, see :meth:`Source.call`."""
        return self._client.call(method, **params)

    def close(self) -> None:
        """Disconnect; iterators that were handed out have connections of their own."""
        self._client.close()

    def _offered(self, hello: dict[str, Any]) -> list[str]:
        """The daemon's addresses for a client like this one."""
        protected = self._keys is not None and not self.address.startswith("ipc://")
        return _reachable(hello.get("remote" if protected else "stream", ()), self.address)

    def _checked_stream(self, candidates: list[str]) -> str:
        """The first address that accepts this client."""
        problems = []
        for endpoint in candidates:
            problem = handshake_problem(endpoint, self._keys, kind=zmq.SUB)
            if not problem:
                return endpoint
            problems.append(f"{endpoint}: {problem}")
        raise NoDaemonError(
            f"the stream of {self.address} cannot be reached: {'; '.join(problems) or 'it has no address for clients'}"
            "; name one that can: Rig(..., stream='tcp://HOST:PORT')"
        )


def _control_address(address: str | None) -> str:
    if address is None:
        return found_control_endpoint()
    if isinstance(address, str) and "://" not in address and address:
        address = f"tcp://{address}" if ":" in address else f"tcp://{address}:{CONTROL_PORT}"
    return checked_endpoint(address, name="address")


def _reachable(endpoints: list[str], control: str) -> list[str]:
    """The stream's addresses as a client of this control address sees them, local sockets first."""
    host = host_of(control)
    local = not host or host in _LOOPBACK
    found = []
    for endpoint in endpoints:
        bound = host_of(endpoint)
        if endpoint.startswith("ipc://"):
            found += [endpoint] if local else []
        elif bound in _EVERY_HOST:
            shown = host or "127.0.0.1"
            found.append(f"tcp://{f'[{shown}]' if ':' in shown else shown}:{port_of(endpoint)}")
        elif local or bound not in _LOOPBACK:
            found.append(endpoint)
    return sorted(found, key=lambda endpoint: not endpoint.startswith("ipc://"))
