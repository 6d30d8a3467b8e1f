"""Thousands of messages from a grammar: nothing fails, settings change by valid requests only, memory is constant."""

from __future__ import annotations

import gc
import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from daemon.config.load import check_rig
from daemon.control.rpc.protocol import INTERNAL_ERROR, MAX_ANSWER_BYTES
from daemon.control.rpc.server import ControlServer
from daemon.control.settings.flatten import leaves
from daemon.control.settings.live_settings import is_live
from tests.daemon.running_daemon import warmed
from tools.waiting import wait_until

VARIATIONS = 20
GROWTH_BYTES = 96 << 20

PATHS = (
    "pairing.tolerance_us",
    "pairing.max_wait_ms",
    "pipeline.settings.min_modulation",
    "pipeline.settings.window_radius",
    "stream.preview_hz",
    "recording.min_free_mb",
    "recording.dir",
    "volume",
    "device.name",
    "control.endpoint",
    "pipeline",
    "pipeline.settings.__class__",
    "pairing.tolerance_us.real",
    "",
)
METHODS = ("hello", "status", "start", "stop", "get", "set", "reload", "snapshot", "record.stop", "pattern.show")

numbers = st.one_of(st.integers(-10, 3000), st.integers(), st.floats(allow_nan=False, allow_infinity=False))
plain = st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=20))
values = st.recursive(plain, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner))
params = st.one_of(
    values,
    st.fixed_dictionaries({"path": st.sampled_from(PATHS), "value": values}),
    st.fixed_dictionaries({"path": st.sampled_from(PATHS), "value": numbers}),
    st.fixed_dictionaries({}, optional={"name": values, "path": st.sampled_from(PATHS), "detail": st.booleans()}),
    st.dictionaries(st.text(max_size=8), values, max_size=3),
)
requests = st.fixed_dictionaries(
    {"method": st.sampled_from(METHODS) | st.text(max_size=12)},
    optional={"jsonrpc": st.sampled_from(["2.0", "2.0", "1.0", 2]), "id": values, "params": params, "more": values},
).map(lambda request: {"jsonrpc": "2.0"} | request)


@st.composite
def messages(draw: st.DrawFn) -> list[bytes]:
    """The parts of a message: a request, a batch, one of them damaged, or bytes of any kind."""
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return [draw(st.binary(max_size=200)) for _ in range(draw(st.integers(1, 4)))]
    data = json.dumps(draw(st.lists(requests, max_size=4)) if kind == 1 else draw(requests)).encode()
    if kind == 2:
        at = draw(st.integers(0, len(data) - 1))
        data = data[:at] + draw(st.binary(max_size=4)) + data[at + draw(st.integers(0, 3)) :]
    if kind == 3:
        data = data * draw(st.integers(1, 50))
    return [b"", data] if kind == 4 else [data]


class Fuzzed:
    """A running daemon, its control socket, and a client."""

    def __init__(self, path: Path) -> None:
        self.running = warmed(path)
        self.server = ControlServer(f"ipc://{path}/control", self.running.methods)
        self.server.start()
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.socket = self.context.socket(zmq.DEALER)
        self.socket.connect(self.server.endpoint)
        self.sent, self.asked = 0, 0
        self.requested: dict[str, list[Any]] = {}
        self.first = self.leaves()

    def leaves(self) -> dict[str, Any]:
        service = self.running.service
        return leaves(service.config, service.settings)

    def send(self, parts: list[bytes]) -> None:
        self.socket.send_multipart(parts)
        self.sent += 1
        for path, value in _requests(parts[-1]):
            self.requested.setdefault(path, []).append(value)

    def settle(self) -> None:
        """Wait until every message has been served; every response is valid."""
        self.asked += 1
        name, asked = f"settle {self.asked}", 0
        hello = json.dumps({"jsonrpc": "2.0", "id": name, "method": "hello"}).encode()
        while True:
            while not asked or not self.socket.poll(3000):
                # Answers that do not fit into the queue to a client are dropped, this one perhaps among them.
                asked += 1
                assert asked < 30, "the daemon does not answer any more"
                self.socket.send(hello)
            data = self.socket.recv_multipart()[-1]
            assert len(data) <= MAX_ANSWER_BYTES
            answer = json.loads(data)
            for one in answer if isinstance(answer, list) else [answer]:
                assert one["jsonrpc"] == "2.0" and ("result" in one) != ("error" in one)
                assert "error" not in one or one["error"]["code"] != INTERNAL_ERROR, one
            if isinstance(answer, dict) and answer.get("id") == name:
                return

    def check(self) -> None:
        """Check that only requested settings have changed, to values that are valid in rig.yaml."""
        service = self.running.service
        now = self.leaves()
        assert now.keys() == self.first.keys()
        for path, value in now.items():
            if value != self.first[path]:
                assert is_live(path) and value in self.requested.get(path, []), path
        check_rig(service.config.model_dump(mode="json"), base_dir=self.running.path)

    def close(self) -> None:
        self.context.destroy(linger=0)
        self.server.close()
        self.running.stop()


def _requests(data: bytes) -> Iterator[tuple[str, Any]]:
    try:
        parsed = json.loads(data)
    except (ValueError, RecursionError):
        return
    for request in parsed if isinstance(parsed, list) else [parsed]:
        asked = request.get("params") if isinstance(request, dict) else None
        if isinstance(asked, list) and len(asked) == 2 and isinstance(asked[0], str):
            yield asked[0], asked[1]
        if isinstance(asked, dict) and isinstance(asked.get("path"), str) and "value" in asked:
            yield asked["path"], asked["value"]


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fuzzed]:
    made = Fuzzed(tmp_path_factory.mktemp("fuzz"))
    yield made
    made.close()


def resident_bytes() -> int:
    text = Path("/proc/self/status").read_text()
    (line,) = (line for line in text.splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) << 10


def variations(parts: list[bytes]) -> Iterator[list[bytes]]:
    """The message, intact or damaged: cut, with flipped bits, repeated, or with other bytes inserted."""
    yield parts
    chance = random.Random(parts[-1])
    for _ in range(VARIATIONS - 1):
        data = bytearray(parts[-1] or b"{}")
        at, kind = chance.randrange(len(data)), chance.randrange(5)
        if kind == 0:
            del data[at:]
        elif kind == 1:
            data[at] ^= 1 << chance.randrange(8)
        elif kind == 2:
            data[at:at] = data[: chance.randrange(len(data) + 1)]
        elif kind == 3:
            data[at : at + 1] = chance.choice((b"0", b"-", b"9" * 400, b"e999", b"[" * 2000, b'"', b"\\ud800", b"null"))
        yield [*parts[:-1], bytes(data)]


@pytest.mark.parametrize("count", [1_000, pytest.param(10_000, marks=pytest.mark.long)])
@pytest.mark.timeout(600)
def test_thousands_of_messages_harm_nothing(fuzzed: Fuzzed, count: int) -> None:
    running, sent = fuzzed.running, fuzzed.sent

    @settings(
        max_examples=count // VARIATIONS,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(messages())
    def send_all(message: list[bytes]) -> None:
        for parts in variations(message):
            fuzzed.send(parts)
        if fuzzed.sent % 200 == 0:
            fuzzed.settle()
            fuzzed.check()

    fuzzed.settle()
    gc.collect()
    before = resident_bytes()
    send_all()
    assert fuzzed.sent - sent >= count
    wait_until(lambda: not fuzzed.server._background.running, 60)
    fuzzed.settle()
    fuzzed.check()
    gc.collect()
    assert resident_bytes() - before < GROWTH_BYTES
    assert running.call("record.stop")["recording"] is False
    running.call("start")
    running.call("set", path="pairing.tolerance_us", value=2000.0)
    running.call("set", path="pairing.max_wait_ms", value=500.0)
    running.call("pattern.show")
    assert running.thread.is_alive() and running.service.state()[0] in ("running", "degraded")
