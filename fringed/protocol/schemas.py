"""JSON Schemas of the protocol, made from its tables; ``load`` reads the committed ones of the installed package."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

import msgspec

from fringed import wire
from fringed.protocol.limits import ERRORS
from fringed.protocol.methods import METHODS
from fringed.protocol.status import Status
from fringed.protocol.topics import TOPICS, Topic

DRAFT = "https://json-schema.org/draft/2020-12/schema"
NAMES = ("stream", "control")

Schema = dict[str, Any]


def load(name: str) -> Schema:
    """Return a schema of the package: ``stream`` (a header of each topic) or ``control`` (requests and answers)."""
    file = resources.files("fringed.protocol") / "schema" / f"{name}.schema.json"
    schema: Schema = json.loads(file.read_text(encoding="utf-8"))
    return schema


def of_topic(name: str, schema: Schema) -> Schema:
    """Return the schema of a topic's header, from the one of the stream."""
    return definition(_key(name), schema)


def of_method(name: str, member: str, schema: Schema) -> Schema:
    """Return the schema of a method's ``params`` or ``result``, from the one of control."""
    return definition(f"{name}.{member}", schema)


def definition(name: str, schema: Schema) -> Schema:
    """Return a definition of a schema, such as ``request`` or ``response``, as a schema of its own."""
    return {"$schema": DRAFT, "$ref": f"#/$defs/{name}", "$defs": schema["$defs"]}


def stream() -> Schema:
    """Return the schema of the stream: ``$defs`` has one for the header of each topic."""
    definitions: Schema = {}
    for topic in TOPICS:
        definitions[_key(topic.name)] = _header(topic, definitions)
    return {
        "$schema": DRAFT,
        "title": "Headers of the stream, version 1, by topic",
        "oneOf": [{"$ref": f"#/$defs/{kind}"} for kind in sorted({_key(topic.name) for topic in TOPICS})],
        "$defs": definitions,
    }


def control() -> Schema:
    """Return the schema of control: ``$defs`` has request, response, and METHOD.params and METHOD.result."""
    definitions: Schema = {}
    for method in METHODS:
        definitions[f"{method.name}.params"] = _schema(method.params, definitions)
        definitions[f"{method.name}.result"] = _schema(method.result, definitions)
    identity = {"type": ["string", "number", "null"]}
    definitions["request"] = {
        "type": "object",
        "properties": {
            "jsonrpc": {"const": "2.0"},
            "id": identity | {"description": "without one, there is no response"},
            "method": {"enum": [method.name for method in METHODS]},
            "params": {"type": ["object", "array"]},
        },
        "required": ["jsonrpc", "method"],
        "allOf": [
            {
                "if": {"properties": {"method": {"const": method.name}, "params": {"type": "object"}}},
                "then": {"properties": {"params": {"$ref": f"#/$defs/{method.name}.params"}}},
            }
            for method in METHODS
        ],
    }
    error = {
        "type": "object",
        "properties": {
            "code": {"enum": list(ERRORS)},
            "message": {"type": "string"},
            "data": {"type": "object", "properties": {"path": {"type": "string"}}},
        },
        "required": ["code", "message"],
    }
    definitions["response"] = {
        "type": "object",
        "properties": {"jsonrpc": {"const": "2.0"}, "id": identity, "result": {}, "error": error},
        "required": ["jsonrpc", "id"],
        "oneOf": [{"required": ["result"]}, {"required": ["error"]}],
    }
    return {
        "$schema": DRAFT,
        "title": "JSON-RPC messages of control, version 1",
        "oneOf": [{"$ref": "#/$defs/request"}, {"$ref": "#/$defs/response"}],
        "$defs": definitions,
    }


def strict(schema: Any) -> Any:
    """Return a schema that also refuses undocumented keys; for tests, as readers ignore unknown keys."""
    if isinstance(schema, list):
        return [strict(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {key: strict(value) for key, value in schema.items()}
    if schema.get("type") == "object" and "properties" in schema and "additionalProperties" not in schema:
        closed["additionalProperties"] = False
    return closed


def _key(topic: str) -> str:
    """The name of a topic's definition: a slash would be a separator in a reference."""
    chosen = topic.startswith(("cloud/parts/", "cloud/shared/"))
    return ".".join(topic.split("/")[:2]) if chosen else topic.replace("/", ".")


def _header(topic: Topic, definitions: Schema) -> Schema:
    header = dict(definitions[_schema(topic.header, definitions)["$ref"].removeprefix("#/$defs/")])
    properties = dict(header["properties"])
    properties["kind"] = {"const": topic.kind}
    properties["v"] = {"const": wire.VERSION}
    properties["parts"] = _parts(topic, definitions)
    if topic.stats is not None:
        properties["stats"] = _schema(topic.stats, definitions)
    if topic.data is Status:
        properties["data"] = _status_body(definitions)
    elif topic.data is not None:
        properties["data"] = _schema(topic.data, definitions)
    else:
        properties.pop("data", None)
    required = ["kind", "v", "seq", "t_ns", "session", "device", "calibration", "parts"]
    required += [name for name in ("frame", "unit", "width", "height", "stats") if name in properties]
    required += ["data"] if topic.data is not None else []
    return {
        "description": f"{topic.name}: {topic.text}",
        "type": "object",
        "properties": properties,
        "required": required,
    }


def _parts(topic: Topic, definitions: Schema) -> Schema:
    row = _schema(wire.Part, definitions)
    conditions: list[Schema] = []
    for part in topic.parts:
        # Without room in shared memory the message has the part itself.
        codec = {"enum": ["shared", "none"]} if part.codec == "shared" else {"const": part.codec}
        wanted: Schema = {"name": {"const": part.name}, "dtype": {"const": part.dtype}, "codec": codec}
        wanted |= {"media": {"const": part.media}} if part.media else {}
        keys = [*wanted, "shape", *(("scale", "offset") if part.codec == "blosc2" else ())]
        if part.required:
            conditions.append({"contains": {"properties": wanted, "required": keys}})
        else:
            named = {"properties": {"name": wanted["name"]}}
            conditions.append({"items": {"if": named, "then": {"properties": wanted}}})
    return {"type": "array", "items": row} | ({"allOf": conditions} if conditions else {"maxItems": 0})


def _status_body(definitions: Schema) -> Schema:
    """The status without required keys: the longest are left out where the header has no room for them."""
    whole = definitions[_schema(Status, definitions)["$ref"].removeprefix("#/$defs/")]
    left_out = {"type": "array", "items": {"type": "string"}, "description": "keys that did not fit"}
    body = {key: value for key, value in whole.items() if key != "required"}
    return body | {"properties": whole["properties"] | {"left_out": left_out}}


def _schema(kind: Any, definitions: Schema) -> Schema:
    """Return the schema of a type; those of its structures are added to the definitions."""
    (schema,), components = msgspec.json.schema_components([kind], ref_template="#/$defs/{name}")
    for name, component in components.items():
        definitions.setdefault(name, component)
    if definitions.get("Part", {}).get("title") == "Part":
        properties = definitions["Part"]["properties"]
        properties["dtype"] = {"enum": list(wire.DTYPES)}
        properties["codec"] = {"enum": list(wire.CODECS)}
    return dict(schema)


def text(schema: Schema) -> str:
    """Return a schema as text, as it is committed."""
    return json.dumps(schema, indent=1, sort_keys=False) + "\n"
