"""Recorded and live messages of every kind satisfy the schemas, without an undocumented key."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import pytest

from fringed.conformance.recorded import exchanges, messages
from fringed.protocol import schemas
from fringed.protocol.methods import METHODS
from fringed.protocol.topics import RECORDED, TOPICS, topic_of
from tests.daemon.whole_daemon import measuring
from tests.fringed.conformance.make import record_control, record_stream

STREAM, CONTROL = schemas.load("stream"), schemas.load("control")
STRICT_STREAM, STRICT_CONTROL = schemas.strict(STREAM), schemas.strict(CONTROL)
FROM_FUTURE = "flavour"
"""A key of the recorded message with unknown keys."""


def check(value: Any, schema: dict[str, Any]) -> None:
    jsonschema.Draft202012Validator(schema).validate(value)


def check_message(frames: list[bytes], *, strict: bool = True) -> str:
    topic = frames[0].decode()
    check(json.loads(frames[1]), schemas.of_topic(topic, STRICT_STREAM if strict else STREAM))
    return topic_of(topic).name


def check_exchange(exchange: dict[str, Any]) -> str | None:
    """Validate request and response; returns the method if it succeeded."""
    request, response = exchange["request"], exchange["response"]
    check(response, schemas.definition("response", CONTROL))
    name = request["method"]
    if "result" not in response:
        return None
    check(request, schemas.definition("request", CONTROL))
    check(response["result"], schemas.of_method(name, "result", STRICT_CONTROL))
    return str(name)


@pytest.mark.parametrize("schema", [STREAM, CONTROL, STRICT_STREAM, STRICT_CONTROL])
def test_the_schemas_are_schemas(schema: dict[str, Any]) -> None:
    jsonschema.Draft202012Validator.check_schema(schema)


def test_recorded_messages_satisfy_the_schemas() -> None:
    topics = {check_message(frames, strict=FROM_FUTURE not in json.loads(frames[1])) for frames in messages("valid")}
    assert topics == {topic.name for topic in RECORDED}


def test_recorded_answers_satisfy_the_schemas() -> None:
    succeeded = {check_exchange(exchange) for exchange in exchanges()}
    needs_a_hand = {"calibrate.capture", "calibrate.next_pose"}
    assert succeeded - {None} == {method.name for method in METHODS} - needs_a_hand


def test_live_messages_and_answers_satisfy_the_schemas(tmp_path: Any) -> None:
    with measuring(tmp_path) as control:
        for exchange in record_control(control):
            check_exchange(exchange)
        topics = {check_message(frames) for frames in record_stream(f"ipc://{tmp_path}/s", control, TOPICS)}
    assert topics == {topic.name for topic in TOPICS}


@pytest.mark.parametrize("topic", [topic.name for topic in RECORDED])
def test_a_header_without_a_required_key_or_of_another_type_is_refused(topic: str) -> None:
    header = json.loads(next(frames for frames in messages("valid") if topic_of(frames[0].decode()).name == topic)[1])
    schema = schemas.of_topic(topic, STREAM)
    required = STREAM["$defs"][schema["$ref"].removeprefix("#/$defs/")]["required"]
    assert {"kind", "v", "seq", "parts"} <= set(required)
    for key in required:
        for wrong in ({name: value for name, value in header.items() if name != key}, header | {key: object}):
            with pytest.raises(jsonschema.ValidationError):
                check(wrong, schema)
    if header["parts"]:
        with pytest.raises(jsonschema.ValidationError):
            check(header | {"parts": header["parts"][1:]}, schema)


@pytest.mark.parametrize("name", [method.name for method in METHODS if method.name != "calibrate.capture"])
def test_unknown_parameters_are_refused(name: str) -> None:
    request = {"jsonrpc": "2.0", "id": 1, "method": name, "params": {"no_such_parameter": 1}}
    with pytest.raises(jsonschema.ValidationError):
        check(request, schemas.definition("request", CONTROL))
