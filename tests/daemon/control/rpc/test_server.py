"""Control: every request gets its response, and no message harms the daemon."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.common.errors import DaemonError
from daemon.control.rpc.protocol import MAX_BYTES, Method, Role, RpcError, respond
from daemon.control.rpc.server import ControlServer
from fringed.control.client import ControlClient
from fringed.errors import ControlError


def refuse(_: dict[str, Any]) -> None:
    raise RpcError(-32602, "too large", "pipeline.settings.x")


METHODS = {
    "echo": Method(lambda params: params, ("a",), role=Role.VIEW),
    "refuse": Method(refuse),
    "crash": Method(lambda params: params["nothing"]),
}


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ControlServer]:
    made = ControlServer(f"ipc://{tmp_path}/control", METHODS)
    made.start()
    yield made
    made.close()
    assert not (tmp_path / "control").exists()


def alive(server: ControlServer) -> None:
    with ControlClient(server.endpoint) as client:
        assert client.call("echo", a=1) == {"a": 1}


def test_a_request_has_a_response(server: ControlServer) -> None:
    alive(server)


def test_an_error_carries_code_message_and_path() -> None:
    response = json.loads(respond(b'{"jsonrpc": "2.0", "id": 7, "method": "refuse"}', METHODS) or b"")
    assert response["id"] == 7
    assert response["error"] == {"code": -32602, "message": "too large", "data": {"path": "pipeline.settings.x"}}


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (b"", -32700),
        (b"\xff\xfe", -32700),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "echo", "params": {"a": NaN}}', -32700),
        (b"[" * 60_000, -32700),
        (b"[]", -32600),
        (b'{"id": 1, "method": "echo"}', -32600),
        (b'{"jsonrpc": "2.0", "id": {}, "method": "echo"}', -32600),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "nothing"}', -32601),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "echo", "params": [1, 2]}', -32602),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "crash"}', -32603),
        (b" " * (MAX_BYTES + 1), -32600),
    ],
)
def test_what_is_not_a_request_gets_its_error(message: bytes, code: int) -> None:
    assert json.loads(respond(message, METHODS) or b"{}")["error"]["code"] == code


def test_a_notification_has_no_response() -> None:
    assert respond(b'{"jsonrpc": "2.0", "method": "echo"}', METHODS) is None


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_get_a_valid_response_or_none(message: bytes) -> None:
    response = respond(message, METHODS)
    assert response is None or json.loads(response)["jsonrpc"] == "2.0"


def test_a_plain_req_socket_works_too(server: ControlServer) -> None:
    with zmq.Context() as context, context.socket(zmq.REQ) as request:
        request.setsockopt(zmq.LINGER, 0)
        request.connect(server.endpoint)
        request.send(b'{"jsonrpc": "2.0", "id": 1, "method": "echo"}')
        assert request.poll(5000) and json.loads(request.recv())["result"] == {}


@pytest.mark.parametrize(
    "parts",
    [[b"x" * 100_000_000], [b"garbage"], [b""], [b"a", b"b", b"c", b"d"], [b"{}"] * 2000],
    ids=["100 MB", "garbage", "nothing", "four parts", "many parts"],
)
def test_no_message_harms_the_daemon(server: ControlServer, parts: list[bytes]) -> None:
    with zmq.Context() as context, context.socket(zmq.DEALER) as rude:
        rude.setsockopt(zmq.LINGER, 0)
        rude.connect(server.endpoint)
        rude.send_multipart(parts)
        rude.poll(300)
    alive(server)


def test_bytes_that_are_no_zeromq_do_not_harm_the_daemon(server: ControlServer) -> None:
    with socket.socket(socket.AF_UNIX) as raw:
        raw.connect(server.endpoint.removeprefix("ipc://"))
        raw.sendall(b"GET / HTTP/1.1\r\n\r\n" * 100)
        alive(server)
    alive(server)


def test_a_second_daemon_on_the_same_socket_is_refused(server: ControlServer) -> None:
    with pytest.raises(DaemonError, match="another daemon"):
        ControlServer(server.endpoint, METHODS)
    alive(server)


def test_a_socket_file_that_a_dead_daemon_left_is_taken_over(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "control"))
    again = ControlServer(f"ipc://{tmp_path}/control", METHODS)
    again.start()
    alive(again)
    again.close()


def test_the_client_reports_a_missing_daemon(tmp_path: Path) -> None:
    with (
        ControlClient(f"ipc://{tmp_path}/none", timeout_s=0.1) as client,
        pytest.raises(ControlError, match="no daemon"),
    ):
        client.call("status")


def test_the_client_reports_the_daemons_message(server: ControlServer) -> None:
    with ControlClient(server.endpoint) as client, pytest.raises(ControlError, match="too large"):
        client.call("refuse")
