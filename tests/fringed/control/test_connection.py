"""A missing daemon is known at once, whatever stands at its address."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from daemon.control.rpc.protocol import Method
from daemon.control.rpc.server import ControlServer
from fringed.control.client import ControlClient
from fringed.errors import NoDaemonError

PATIENCE_S = 60.0  # of the client; the answer comes long before


def refusal(endpoint: str, timeout_s: float = PATIENCE_S) -> str:
    """The message about a missing daemon, which comes within a second."""
    start_s = time.monotonic()
    with ControlClient(endpoint, timeout_s=timeout_s) as client, pytest.raises(NoDaemonError) as raised:
        client.call("status")
    assert time.monotonic() - start_s < 1.0
    message = str(raised.value)
    assert message.startswith(f"no daemon answers at {endpoint}: ") and "\n" not in message
    assert "fringed run rig.yaml" in message
    return message


@contextmanager
def listening(answer: bytes) -> Iterator[str]:
    """Another program at a TCP port, which answers anything with these bytes and closes."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(64)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        thread.join(30)
        assert not thread.is_alive()


def test_a_missing_socket_file() -> None:
    assert "there is no such socket" in refusal("ipc:///nonexistent/control")


def test_a_socket_that_a_dead_daemon_left(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "control"))
    assert "left the socket behind" in refusal(f"ipc://{tmp_path}/control")


def test_a_file_that_is_no_socket(tmp_path: Path) -> None:
    (tmp_path / "control").touch()
    assert "no socket" in refusal(f"ipc://{tmp_path}/control")


def test_a_refused_port_and_another_program() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    assert "nothing listens there" in refusal(f"tcp://127.0.0.1:{free}")
    with listening(b"HTTP/1.0 400 Bad Request\r\n\r\n") as endpoint:
        assert "listens there" in refusal(endpoint)


@pytest.mark.parametrize("endpoint", ["status", "ipc://", "tcp://127.0.0.1:port", "tcp://nosuch.invalid:5558"])
def test_what_is_no_address(endpoint: str) -> None:
    refusal(endpoint)


def test_a_client_finds_a_daemon_that_is_started_later_and_again(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/control"
    with ControlClient(endpoint, timeout_s=PATIENCE_S) as client:
        for _ in range(2):
            refusal(endpoint)
            server = ControlServer(endpoint, {"hello": Method(lambda _: "here")})
            server.start()
            assert client.call("hello") == "here"
            server.close()


def test_a_port_that_accepts_and_stays_silent_uses_the_whole_time_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        message = refusal(f"tcp://127.0.0.1:{server.getsockname()[1]}", timeout_s=0.9)
    assert "no response within 0.9 s" in message
