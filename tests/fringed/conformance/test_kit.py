"""The conformance kit: the reference client passes, and every deviation is found."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from fringed import RefusedError, Rig
from fringed.conformance import reference_client
from fringed.conformance.__main__ import main
from fringed.conformance.judge import problems
from fringed.conformance.recorded import expected, messages, pack, unpack
from fringed.conformance.server import Server
from fringed.protocol.topics import RECORDED, topic_of

Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with Server("tcp://127.0.0.1:*", "tcp://127.0.0.1:*", period_s=0.001) as made:
        yield made


@pytest.fixture(scope="module")
def results(server: Server) -> Rows:
    out = io.StringIO()
    reference_client.run(server.stream, server.control, out, timeout_s=60)
    return [json.loads(line) for line in out.getvalue().splitlines()]


def judged(rows: Rows) -> list[str]:
    return problems((json.dumps(row) for row in rows), expected())


def test_the_reference_client_conforms(results: Rows, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert judged(results) == []
    file = tmp_path / "results.jsonl"
    file.write_text("\n".join(json.dumps(row) for row in results))
    assert main(["check", str(file)]) == 0 and capsys.readouterr().out == "conforming\n"
    file.write_text("")
    assert main(["check", str(file)]) == 1
    assert main(["expected"]) == 0


def test_every_topic_and_every_refusal_is_expected() -> None:
    assert {topic_of(row["topic"]).name for row in expected()["messages"]} == {topic.name for topic in RECORDED}
    assert len(expected()["refused"]) == len(messages("refused")) > 15
    stats = [row["header"].get("stats", {}) for row in expected()["messages"]]
    assert any(each.get("every") == 2 for each in stats) and any(each.get("mode") == "gray" for each in stats)


def test_each_line_that_is_missing_is_found(results: Rows) -> None:
    for number in range(len(results)):
        assert len(judged(results[:number] + results[number + 1 :])) == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda row: row["parts"]["xyz"].update(sha256="0"),
        lambda row: row["parts"]["xyz"].update(shape=[1]),
        lambda row: row["header"].update(t_ns=1),
        lambda row: row.update(points=row["points"] + 1),
        lambda row: row.update(mean_mm=[row["mean_mm"][0] + 1, *row["mean_mm"][1:]]),
        lambda row: row.update(mean_mm=None),
    ],
)
def test_a_wrong_decoding_is_found(results: Rows, change: Callable[[Any], object]) -> None:
    changed = json.loads(json.dumps(results))
    change(next(row for row in changed if row.get("topic") == "cloud/full"))
    assert len(judged(changed)) == 1


def test_an_accepted_malformed_message_and_a_wrong_answer_are_found(results: Rows) -> None:
    assert "accepted" in judged([*results, {"topic": "refused/version", "header": {}, "parts": {}}])[0]
    other = [row | {"result": 5} if row.get("method") == "hello" else row for row in results]
    assert "another result" in judged(other)[0]
    assert "line" in problems(["{"], expected())[0]


def test_files_of_messages_come_back() -> None:
    assert list(unpack(pack(messages("refused")))) == messages("refused")


def test_the_python_client_works_on_the_kit(server: Server) -> None:
    with Rig(server.control, stream=server.stream, timeout_s=60) as rig:
        assert rig.status().device == rig.hello().device == "rig-t"
        assert rig.health().verdict and rig.mode().mode == "single"
        with pytest.raises(RefusedError) as raised:
            rig.set("device.name", "other")
        assert raised.value.path == "device.name"
        for topic in ("cloud/full", "cloud/depth"):
            with rig.clouds(topic=topic, latest=False, timeout_s=60) as clouds:
                wanted = {
                    row["header"]["seq"]: row["points"] for row in expected()["messages"] if row["topic"] == topic
                }
                while wanted:
                    cloud = next(clouds)
                    if cloud.header.seq in wanted:
                        assert len(cloud.points) == wanted.pop(cloud.header.seq)


def test_the_server_answers_what_is_no_request(server: Server) -> None:
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.connect(server.control)
        for message, code in ((b"{", -32700), (b"5", -32600), (b'{"jsonrpc": "2.0", "id": 1, "method": "x"}', -32601)):
            socket.send(message)
            assert socket.poll(60_000)
            assert json.loads(socket.recv())["error"]["code"] == code
        socket.send(b'[{"jsonrpc": "2.0", "method": "stop"}, {"jsonrpc": "2.0", "id": 1, "method": "hello"}]')
        assert socket.poll(60_000)
        (only,) = json.loads(socket.recv())
        assert only["result"]["protocol"] == 1
