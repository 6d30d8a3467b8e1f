"""A stream, a control socket and their gate, as in a daemon, and tools of an attacker."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import zmq

from daemon.control.rpc.protocol import Method, Role
from daemon.control.rpc.server import ControlServer
from daemon.keys import authorized_keys
from daemon.keys.authorized_keys import Entry
from daemon.keys.key_store import KeyStore
from daemon.live.publishing.publisher import Publisher
from daemon.remote_access.gate_messages import GateConfig
from daemon.remote_access.gate_sink import RemoteGate
from fringed import Keys, SilenceError, subscribe
from fringed.control.client import ControlClient
from fringed.keys import Key, new_key
from tests.daemon.live.publishing import clouds
from tools.waiting import wait_until

PATIENCE_S = 90.0
CONNECTIONS = 32


class World:
    """Everything behind one gate; clouds flow all the time."""

    def __init__(self, publisher: Publisher, folder: Path) -> None:
        self.publisher = publisher
        self.called: list[tuple[str, dict[str, Any]]] = []
        self.store = KeyStore(folder / "keys")
        self.server = self.store.make_server()
        self.viewer, self.operator, self.stranger = (new_key(name) for name in ("viewer", "operator", "stranger"))
        self.allow(self.viewer, "view")
        self.allow(self.operator, "operate")
        methods = {
            "status": self._method("status", Role.VIEW),
            "set": self._method("set", Role.OPERATE),
            "stop": self._method("stop", Role.OPERATE),
        }
        self.control = ControlServer(f"ipc://{folder}/control", methods)
        self.control.start()
        gate_config = GateConfig(
            stream=["tcp://127.0.0.1:*"],
            control=["tcp://127.0.0.1:*"],
            source=publisher.endpoints[0],
            target=self.control.endpoint,
            roles={name: str(method.role) for name, method in methods.items()},
            connections=CONNECTIONS,
        )
        self.gate = RemoteGate(gate_config, self.store)
        self._done = threading.Event()
        self._sender = threading.Thread(target=self._send, daemon=True)
        self._sender.start()

    def _method(self, name: str, role: Role) -> Method:
        def call(params: dict[str, Any]) -> str:
            self.called.append((name, params))
            return "done"

        return Method(call, ("value", "path"), role)

    def _send(self) -> None:
        seq = 0
        while not self._done.wait(0.05):
            seq += 1
            self.publisher.offer(clouds.item(seq))

    def allow(self, key: Key, control: str, stream: str = "view") -> None:
        """Write a key into the list."""
        self.store.allow(
            Entry(
                key.name, authorized_keys.role("stream", stream), authorized_keys.role("control", control), key.public
            )
        )

    def revoke(self, name: str) -> None:
        """Take a key out of the list; returns when connections were cut, so that none is made that will be."""
        before = sum(self.gate.status()["cut"].values())
        self.store.revoke(name)
        wait_until(lambda: sum(self.gate.status()["cut"].values()) > before)

    def keys(self, key: Key, server: Key | None = None) -> Keys:
        """What a client with this key uses."""
        return Keys(key.public, str(key.secret), (server or self.server).public)

    @property
    def stream(self) -> str:
        return str(self.gate.status()["stream"][0])

    @property
    def control_at(self) -> str:
        return str(self.gate.status()["control"][0])

    def ports(self) -> list[int]:
        return [int(endpoint.rpartition(":")[2]) for endpoint in (self.stream, self.control_at)]

    def refused(self, name: str) -> int:
        return int(self.gate.status()["refused"].get(name, 0))

    def memory_mb(self) -> float:
        """Of the gate's process, now."""
        return int(Path(f"/proc/{self.gate.pid}/statm").read_text().split()[1]) * 4096 / 1e6

    def client(self, key: Key | None, *, timeout_s: float = PATIENCE_S, server: Key | None = None) -> ControlClient:
        keys = None if key is None else self.keys(key, server)
        return ControlClient(self.control_at, timeout_s=timeout_s, keys=keys)

    def operate(self) -> None:
        """An allowed key operates."""
        with self.client(self.operator) as client:
            assert client.call("set", value=1) == "done"

    def sees(self, key: Key, *, timeout_s: float = PATIENCE_S, server: Key | None = None) -> bool:
        """Whether a cloud comes to a subscriber with this key."""
        stream = subscribe(self.stream, timeout_s=timeout_s, keys=self.keys(key, server))
        with closing(stream), suppress(SilenceError):
            return bool(next(stream).points.size)
        return False

    def lives(self) -> None:
        """The gate that was started first lets allowed keys in, to see and to operate."""
        assert self.sees(self.viewer)
        self.operate()
        assert self.gate.status()["restarts"] == 0

    def close(self) -> None:
        self._done.set()
        self._sender.join()
        self.gate.close()
        self.control.close()


@contextmanager
def world(folder: Path) -> Iterator[World]:
    with clouds.publisher(f"ipc://{folder}/stream") as publisher, closing(World(publisher, folder)) as made:
        yield made


def request(method: str, **params: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode()


@contextmanager
def rude(world: World, kind: int, key: Key | None, endpoint: str) -> Iterator[zmq.Socket[Any]]:
    """A bare socket with this key."""
    with zmq.Context() as context, context.socket(kind) as made:
        made.setsockopt(zmq.LINGER, 0)
        if key is not None:
            world.keys(key).apply(made)
        made.connect(endpoint)
        yield made


class Tap:
    """A proxy between a client and a port: records what the client sends, may change one byte of each connection."""

    def __init__(self, port: int, *, flip: int | None = None) -> None:
        self._port, self._flip = port, flip
        self.sent: list[bytes] = []
        self.closed_by_server = 0
        self._closing = False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._closing = True
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        while not self._closing:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with suppress(OSError):
                server = socket.create_connection(("127.0.0.1", self._port))
                self.sent.append(b"")
                number = len(self.sent) - 1
                threading.Thread(target=self._up, args=(client, server, number), daemon=True).start()
                threading.Thread(target=self._down, args=(client, server), daemon=True).start()

    def _up(self, client: socket.socket, server: socket.socket, number: int) -> None:
        with suppress(OSError):
            while data := client.recv(65536):
                begin = len(self.sent[number])
                self.sent[number] += data
                if self._flip is not None and begin <= self._flip < begin + len(data):
                    changed = bytearray(data)
                    changed[self._flip - begin] ^= 0x10
                    data = bytes(changed)
                server.sendall(data)
        for end in (client, server):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _down(self, client: socket.socket, server: socket.socket) -> None:
        with client, server:
            with suppress(OSError):
                while data := server.recv(65536):
                    client.sendall(data)
            self.closed_by_server += 1
            with suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)


def talk(port: int, data: bytes, *, wait_s: float = PATIENCE_S) -> bytes:
    """Send bare bytes to a port, then receive until the other side closes the connection."""
    heard = b""
    with socket.create_connection(("127.0.0.1", port)) as raw:
        raw.settimeout(wait_s)
        with suppress(OSError):
            raw.sendall(data)
        with suppress(OSError):
            while more := raw.recv(65536):
                heard += more
    return heard


def pause_for(seconds: float) -> None:
    """Time in which something that must not happen could happen."""
    time.sleep(seconds)
