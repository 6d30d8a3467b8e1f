"""Slow requests are executed in the background: a hanging disk does not delay requests for the status."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from daemon.control.rpc.background_executor import CAPACITY, BackgroundExecutor, Job
from daemon.control.rpc.protocol import BUSY, FAILED, FORBIDDEN, MAX_ANSWER_BYTES, MAX_BATCH, Method, Role, respond
from daemon.control.rpc.server import ControlServer
from tools.waiting import wait_until


class Slow:
    """A method that waits until it is released."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.calls = 0

    def __call__(self, _: dict[str, Any]) -> str:
        self.calls += 1
        assert self.go.wait(60)
        return "slow"


@pytest.fixture
def slow() -> Iterator[Slow]:
    made = Slow()
    yield made
    made.go.set()


@pytest.fixture
def server(tmp_path: Path, slow: Slow) -> Iterator[ControlServer]:
    methods = {"slow": Method(slow, slow=True), "quick": Method(lambda _: "quick", role=Role.VIEW)}
    made = ControlServer(f"ipc://{tmp_path}/control", methods)
    made.start()
    yield made
    slow.go.set()
    made.close()


class PipelinedClient:
    """A client that sends requests without waiting for responses."""

    def __init__(self, server: ControlServer) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.connect(server.endpoint)

    def send(self, request_id: int | None, method: str) -> None:
        named = {} if request_id is None else {"id": request_id}
        self._socket.send(json.dumps({"jsonrpc": "2.0", "method": method} | named).encode())

    def answer(self) -> dict[str, Any]:
        assert self._socket.poll(30_000), "no answer"
        return dict(json.loads(self._socket.recv()))

    def close(self) -> None:
        self._context.destroy(linger=0)


@pytest.fixture
def client(server: ControlServer) -> Iterator[PipelinedClient]:
    made = PipelinedClient(server)
    yield made
    made.close()


def test_quick_requests_are_served_while_a_slow_one_waits(client: PipelinedClient, slow: Slow) -> None:
    client.send(1, "slow")
    client.send(2, "quick")
    assert client.answer() == {"jsonrpc": "2.0", "id": 2, "result": "quick"}
    slow.go.set()
    assert client.answer()["id"] == 1


def test_slow_requests_beyond_the_capacity_are_busy(client: PipelinedClient, slow: Slow) -> None:
    client.send(0, "slow")
    wait_until(lambda: slow.calls == 1)
    for i in range(1, CAPACITY + 3):
        client.send(i, "slow")
    refused = [client.answer(), client.answer()]
    assert [(one["id"], one["error"]["code"]) for one in refused] == [(CAPACITY + 1, BUSY), (CAPACITY + 2, BUSY)]
    assert "slow" in refused[0]["error"]["message"]
    slow.go.set()
    assert [client.answer()["id"] for _ in range(CAPACITY + 1)] == list(range(CAPACITY + 1))


def test_waiting_requests_are_refused_when_the_daemon_stops(
    client: PipelinedClient, slow: Slow, server: ControlServer
) -> None:
    client.send(1, "slow")
    wait_until(lambda: slow.calls == 1)
    client.send(2, "slow")
    client.send(3, "quick")
    assert client.answer()["id"] == 3
    closing = threading.Thread(target=server.close)
    closing.start()
    wait_until(lambda: not server._background.submit(Job("late", lambda: None, lambda: None)))
    slow.go.set()
    responses = {one["id"]: one for one in (client.answer(), client.answer())}
    assert responses[1]["result"] == "slow" and responses[2]["error"]["code"] == FAILED
    closing.join(30)


def test_a_failing_job_does_not_end_the_executor() -> None:
    executor, done = BackgroundExecutor(), threading.Event()
    executor.start()
    assert executor.submit(Job("bad", lambda: [][0], lambda: None))
    assert executor.submit(Job("good", done.set, lambda: None))
    assert done.wait(30) and executor.close(30)


METHODS = {
    "look": Method(lambda params: params, ("a", "b"), role=Role.VIEW),
    "touch": Method(lambda _: "touched"),
    "much": Method(lambda _: "x" * MAX_ANSWER_BYTES),
    "unknown": Method(lambda _: {"value": [float("nan"), 1.0]}),
}


def asked(request: object, role: Role = Role.OPERATE) -> Any:
    response = respond(json.dumps(request).encode(), METHODS, role)
    return None if response is None else json.loads(response)


def rpc(method: str, request_id: object = 1, **more: object) -> dict[str, object]:
    return {"jsonrpc": "2.0", "id": request_id, "method": method} | more


def test_a_viewer_may_read_and_not_operate() -> None:
    assert asked(rpc("look"), Role.VIEW)["result"] == {}
    assert asked(rpc("touch"), Role.VIEW)["error"]["code"] == FORBIDDEN
    assert asked(rpc("touch"))["result"] == "touched"


def test_parameters_by_position_are_those_by_name() -> None:
    assert asked(rpc("look", params=[1, 2]))["result"] == {"a": 1, "b": 2}
    assert asked(rpc("look", params=[1]))["result"] == {"a": 1}


def test_a_batch_has_one_response_without_its_notifications() -> None:
    silent = {"jsonrpc": "2.0", "method": "touch"}
    answers = asked([rpc("look", 1), silent, 7, rpc("nothing", 2)])
    assert [(one["id"], one.get("error", {}).get("code")) for one in answers] == [
        (1, None),
        (None, -32600),
        (2, -32601),
    ]
    assert asked([silent, silent]) is None
    assert asked([rpc("look")] * (MAX_BATCH + 1))["error"]["code"] == -32600


def test_a_notification_has_no_response_even_when_it_fails() -> None:
    assert asked({"jsonrpc": "2.0", "method": "nothing"}) is None


def test_a_response_is_bounded_and_valid_json() -> None:
    assert asked(rpc("much"))["error"]["code"] == -32603
    assert asked(rpc("unknown"))["result"] == {"value": [None, 1.0]}


@pytest.mark.parametrize("request_id", [True, [1], {}])
def test_an_id_is_a_string_or_a_number(request_id: object) -> None:
    assert asked(rpc("look", request_id))["error"]["code"] == -32600


def test_a_number_that_is_not_finite_is_no_json() -> None:
    response = respond(b'{"jsonrpc": "2.0", "id": 1e999, "method": "status"}', METHODS)
    assert response is not None and json.loads(response)["error"]["code"] == -32700
