"""The metrics on loopback: responses to valid requests, time limits, bounded memory."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from http.client import HTTPConnection

import pytest

from daemon.common.errors import DaemonError
from daemon.monitoring.health.prometheus.http_server import MAX_REQUEST, MOST_CONNECTIONS, MetricsServer

PAGE = "fringed_up 1\n" * 5000


@pytest.fixture
def server() -> Iterator[MetricsServer]:
    made = MetricsServer(0, lambda: PAGE)
    yield made
    made.close()


def ask(server: MetricsServer, method: str = "GET", path: str = "/metrics") -> tuple[int, str]:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=30)
    try:
        connection.request(method, path)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


def raw(server: MetricsServer, data: bytes) -> bytes:
    """Everything that comes back until the server closes."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as made:
        got = b""
        try:
            made.sendall(data)
            while part := made.recv(65536):
                got += part
        except ConnectionError:
            pass
        return got


def test_it_serves_the_metrics_and_refuses_other_requests(server: MetricsServer) -> None:
    assert ask(server) == (200, PAGE)
    assert ask(server, "HEAD") == (200, "")
    assert ask(server, path="/metrics?x=1")[0] == 200
    assert ask(server, path="/")[0] == 404 and ask(server, path="/etc/passwd")[0] == 404
    assert ask(server, "POST")[0] == 405


@pytest.mark.parametrize("data", [b"\x00" * 50 + b"\r\n\r\n", b"GET\r\n\r\n", b"GET /metrics FTP/9\n\n", b"\n\n"])
def test_what_is_not_http_is_refused(server: MetricsServer, data: bytes) -> None:
    assert raw(server, data).startswith(b"HTTP/1.1 400")


def test_an_endless_request_is_refused(server: MetricsServer) -> None:
    got = raw(server, b"GET /metrics HTTP/1.1\r\n" + b"X: y\r\n" * MAX_REQUEST)
    assert got == b"" or got.startswith(b"HTTP/1.1 431")
    assert ask(server)[0] == 200


def test_silent_clients_are_disconnected_and_do_not_block_others(server: MetricsServer) -> None:
    idle = [socket.create_connection(("127.0.0.1", server.port), timeout=30) for _ in range(3 * MOST_CONNECTIONS)]
    try:
        for one in idle:
            with suppress(ConnectionError):
                assert one.recv(10) == b""  # closed by the server, at once or after its patience
        assert ask(server)[0] == 200
    finally:
        for one in idle:
            one.close()


def test_it_is_bound_to_loopback_alone(server: MetricsServer) -> None:
    assert server._listener.getsockname()[0] == "127.0.0.1" and server.address.startswith("http://127.0.0.1:")


def test_a_port_in_use_is_reported(server: MetricsServer) -> None:
    with pytest.raises(DaemonError, match=rf"health\.metrics_port {server.port} is not available"):
        MetricsServer(server.port, lambda: "")


def test_a_failing_page_is_reported_and_the_next_one_tried() -> None:
    def fails() -> str:
        raise ValueError("no")

    made = MetricsServer(0, fails)
    try:
        assert ask(made)[0] == 500 and ask(made)[0] == 500
    finally:
        made.close()
