"""Attacks on the open ports: nothing is accepted, nothing fails, clouds flow, and memory stays constant."""

from __future__ import annotations

import json
import random
import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from typing import Any

import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fringed.control.client import ControlClient
from fringed.keys import Key
from tests.daemon.remote_access.world import CONNECTIONS, Tap, World, request, rude, talk
from tools.waiting import wait_until

pytestmark = pytest.mark.timeout(400)
MOST_GROWTH_MB = 64.0
GREETING_BYTES = 64
GREETING = b"\xff" + b"\0" * 8 + b"\x7f\x03\x01" + b"CURVE".ljust(20, b"\0") + b"\0" * 32


@pytest.fixture(autouse=True)
def unharmed(shared: World) -> Iterator[None]:
    """After each attack the same gate serves those who may, and is no larger."""
    shared.lives()
    before_mb = shared.memory_mb()
    shared.called.clear()
    yield
    shared.lives()
    assert shared.memory_mb() < before_mb + MOST_GROWTH_MB


def recorded(shared: World, key: Key) -> bytes:
    """Everything that a client sent while it operated once."""
    with closing(Tap(shared.ports()[1])) as tap:
        with rude(shared, zmq.DEALER, key, tap.endpoint) as client:
            client.send(request("set", value="recorded"))
            assert client.poll(60_000)
        return tap.sent[0]


def test_recorded_messages_have_no_effect_when_replayed(shared: World) -> None:
    sent = recorded(shared, shared.operator)
    assert shared.called == [("set", {"value": "recorded"})]
    assert b"recorded" not in sent
    before = shared.refused("control_handshake")
    for _ in range(3):
        talk(shared.ports()[1], sent)
    wait_until(lambda: shared.refused("control_handshake") >= before + 3)
    assert len(shared.called) == 1


def test_messages_that_were_recorded_do_not_fit_into_another_connection(shared: World) -> None:
    """An attacker who has a key of its own, and the bytes of a stranger's message."""
    sent = recorded(shared, shared.operator)
    first, port = len(sent), shared.ports()[1]
    shared.called.clear()

    with (
        closing(Tap(port)) as tap,
        ControlClient(tap.endpoint, timeout_s=60, keys=shared.keys(shared.viewer)) as client,
    ):
        client.call("status")
        talk(port, tap.sent[0] + sent[first // 2 :])
    assert [name for name, _ in shared.called] == ["status"]


def test_a_bit_that_was_flipped_on_the_way_changes_nothing_that_is_done(shared: World) -> None:
    """Either it is refused, or what is done is exactly what was asked for."""
    length = len(recorded(shared, shared.operator))
    shared.called.clear()
    rng = random.Random(5)
    asked: list[Any] = []
    for place in (*sorted(rng.sample(range(GREETING_BYTES, length), 12)), length - 20, length - 1):
        value = f"{place:08d}"  # as long as what was recorded
        asked.append(("set", {"value": value}))
        before, refused = len(shared.called), shared.refused("control_handshake")
        tap = Tap(shared.ports()[1], flip=place)
        with closing(tap), rude(shared, zmq.DEALER, shared.operator, tap.endpoint) as client:

            def decided(
                client: Any = client, tap: Tap = tap, value: str = value, before: int = before, refused: int = refused
            ) -> bool:
                # Again and again: a length that was changed makes the other side wait for more.
                with suppress(zmq.Again):
                    client.send(request("set", value=value), zmq.NOBLOCK)
                # ZeroMQ does not always close the connection that it refuses, but it counts it.
                counted = shared.refused("control_handshake") > refused
                return bool(tap.closed_by_server or counted or len(shared.called) > before)

            wait_until(decided)
    shared.operate()  # whatever was on its way has been done before it
    assert all(one in asked for one in shared.called if one[1]["value"] != 1)
    assert not any(asked.index(one) >= 12 for one in shared.called if one in asked)


@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_a_message_that_is_too_large_ends_its_connection(shared: World, role: str) -> None:
    before = shared.gate.status()["accepted"]
    with rude(shared, zmq.DEALER, getattr(shared, role), shared.control_at) as client:
        wait_until(lambda: shared.gate.status()["accepted"] > before)
        client.send(b"x" * 50_000_000)
        client.poll(500)
    assert not shared.called


def test_a_message_that_never_ends_is_not_kept(shared: World) -> None:
    for port in shared.ports():
        with socket.create_connection(("127.0.0.1", port)) as raw:
            raw.settimeout(60)
            raw.sendall(GREETING)
            with suppress(OSError):
                raw.sendall(b"\x06" + (1 << 40).to_bytes(8, "big"))
                for _ in range(2000):
                    raw.sendall(b"\0" * 65536)
            with suppress(OSError):
                while raw.recv(65536):
                    pass


def test_random_bytes_have_no_effect(shared: World) -> None:
    rng = random.Random(11)
    for number in range(120):
        begin = rng.choice([b"", GREETING, GREETING[:12], b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01"])
        noise = begin + rng.randbytes(rng.choice([1, 100, 3000]))
        with socket.create_connection(("127.0.0.1", shared.ports()[number % 2])) as raw, suppress(OSError):
            raw.sendall(noise)
    assert not shared.called


def test_silent_connections_are_limited_and_ended(shared: World) -> None:
    with ExitStack() as held:
        silent = 0

        def many() -> bool:
            nonlocal silent
            if silent < 4 * CONNECTIONS:
                raw = held.enter_context(socket.socket())
                raw.setblocking(False)
                with suppress(BlockingIOError):
                    raw.connect(("127.0.0.1", shared.ports()[silent % 2]))
                silent += 1
            return bool(shared.gate.status()["connections"] >= CONNECTIONS // 2)

        wait_until(many)
        assert shared.gate.status()["connections"] <= CONNECTIONS + 16
        shared.operate()  # it waits for its turn while they are cut off one after the other


def test_subscriptions_of_any_length_and_odd_messages_do_not_reach_the_daemon(shared: World) -> None:
    before = shared.refused("stream_request")
    with rude(shared, zmq.XSUB, shared.viewer, shared.stream) as client:
        for sent in (b"\1" + b"x" * 65, b"\2what", b"", b"\1" + b"y" * 3000, b"\1cloud/shared/full/"):
            client.send(sent)
        client.send(b"\1cloud/full")
        assert client.poll(60_000)
        wait_until(lambda: shared.refused("stream_request") >= before + 3)
    assert all(len(topic) <= 64 and "shared" not in topic for topic in shared.publisher.status()["topics"])


def test_requests_of_many_parts_are_refused(shared: World) -> None:
    before = shared.refused("control_request")
    with rude(shared, zmq.DEALER, shared.operator, shared.control_at) as client:
        client.send_multipart([request("set"), request("set"), request("set")])
        client.send_multipart([b"x"] * 500)
        wait_until(lambda: shared.refused("control_request") >= before + 2)
    assert not shared.called


# Requests as a grammar: valid ones, nearly valid ones, and others of similar form.
_scalars = st.sampled_from([None, True, False, 0, -1, 1.5, 2**63, "", "x", "é\u0000", "set", "a" * 300])
_values = st.recursive(
    _scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "id"]), inner, max_size=2),
)
_methods = st.sampled_from(
    ["set", "stop", "status", "Set", "set ", "set\u0000", "status.set", "", "hello", 7, None, ["set"]]
)
_requests = st.fixed_dictionaries(
    {},
    optional={
        "jsonrpc": st.sampled_from(["2.0", "2.0", "2.0", "1.0", 2]),
        "id": _scalars,
        "method": _methods,
        "params": st.fixed_dictionaries({}, optional={"value": _values, "path": _scalars, "nothing": _scalars})
        | _values,
    },
)
_texts = (_requests | st.lists(_requests, max_size=3)).map(lambda request: json.dumps(request).encode())
_twice = st.sampled_from(
    [
        b'{"jsonrpc": "2.0", "id": 1, "method": "status", "method": "set", "params": {}}',
        b'{"jsonrpc": "2.0", "id": 1, "method": "set", "method": "status", "params": {}}',
        b'{"jsonrpc": "2.0", "id": 1, "method": "s\\u0065t", "params": {"value": 9}}',
        b'{"jsonrpc": "2.0", "id": 1e999, "method": "status"}',
        b'{"jsonrpc": "2.0", "id": 1, "method": "status", "params": {"value": NaN}}',
        b"[" * 20_000,
        b'{"a":' * 5_000,
        b"\xff\xfe{}",
        b"",
    ]
)
_cut = st.builds(lambda text, share: text[: int(share * len(text))], _texts, st.floats(0, 1))
_messages = st.lists(_texts | _cut | _twice | st.binary(max_size=60), min_size=40, max_size=40)


@pytest.mark.parametrize("count", [200, pytest.param(10_000, marks=pytest.mark.long)])
def test_many_messages_through_the_cipher_do_what_their_role_allows_and_nothing_else(shared: World, count: int) -> None:
    counted = 0
    with rude(shared, zmq.DEALER, shared.viewer, shared.control_at) as client:
        client.setsockopt(zmq.RCVHWM, 100_000)
        client.setsockopt(zmq.SNDTIMEO, 60_000)

        @settings(
            max_examples=count // 40,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        )
        @given(_messages)
        def send(messages: list[bytes]) -> None:
            nonlocal counted
            for message in messages:
                client.send(message)
            counted += len(messages)
            while client.poll(0):
                assert json.loads(client.recv())["jsonrpc"] == "2.0"

        send()
        client.send(request("status", value="the last"))
        wait_until(lambda: ("status", {"value": "the last"}) in shared.called)
    assert counted >= count
    assert {name for name, _ in shared.called} == {"status"}
    wait_until(lambda: shared.refused("control_role") > count // 100)
