"""Write the protocol page of the reference and the protocol's JSON Schemas from its tables: ``make protocol``.

Examples are recorded messages of the conformance kit.
"""

from __future__ import annotations

import json
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from fringed import wire
from fringed.conformance.recorded import exchanges, messages
from fringed.protocol import methods, schemas, status, topics
from fringed.protocol.limits import ERRORS, LIMITS
from fringed.shared_memory import Reference

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "protocol.md"
SCHEMAS = ROOT / "fringed" / "protocol" / "schema"
PROSE = ROOT / "tools" / "protocol_prose.md"
_TEXT, _ROWS, _WIDTH = 60, 6, 118
_STRING, _SPACE = r'"(?:[^"\\]|\\.)*"', "\x1f"  # a text in JSON is not broken into lines


def files() -> dict[Path, str]:
    """Return every generated file with its text."""
    made = {SCHEMAS / f"{name}.schema.json": schemas.text(getattr(schemas, name)()) for name in schemas.NAMES}
    return made | {PAGE: page()}


def page() -> str:
    """Return docs/reference/protocol.md: the written sections, with the generated tables in their places."""
    text = PROSE.read_text(encoding="utf-8")
    for name, lines in (
        ("header", keys(wire.Header)), ("cloud", keys(wire.CloudHeader, but=wire.Header)), ("part", keys(wire.Part)),
        ("reference", keys(Reference)),
        ("dtypes", iter([", ".join(f"`{dtype}`" for dtype in wire.DTYPES)])),
        ("codecs", iter([", ".join(f"`{codec}`" for codec in wire.CODECS)])),
        ("topics", topic_sections()), ("methods", method_rows()), ("calls", method_sections()),
        ("status", status_sections()), ("errors", error_rows()), ("limits", limit_rows()), ("refused", refused_rows()),
    ):  # fmt: skip
        place = f"<!-- {name} -->"
        if place not in text:
            raise ValueError(f"{PROSE}: {place} is missing")
        text = text.replace(place, "\n".join(lines))
    return text


def topic_sections() -> Iterator[str]:
    """Yield a section for each topic."""
    recorded: dict[str, bytes] = {}
    for frames in messages("valid"):
        recorded.setdefault(topics.topic_of(frames[0].decode()).name, frames[1])
    described: dict[Any, str] = {}
    for topic in topics.TOPICS:
        kept = " Retained: each new subscriber gets it at once." if topic.retained else ""
        yield f"### {topic.name}\n\n{topic.text} Sent {topic.when}; kind `{topic.kind}`.{kept}\n"
        if topic.parts:
            yield "| part | dtype | shape | codec | contents |\n| --- | --- | --- | --- | --- |"
            for part in topic.parts:
                media = f" ({part.media})" if part.media else "" if part.required else "; optional"
                dtype = part.dtype.replace("|", "\\|")
                yield f"| `{part.name}` | `{dtype}` | {part.shape} | {part.codec} | {part.text}{media} |"
            yield ""
        for member, kind in (("stats", topic.stats), ("data", topic.data)):
            if kind in described:
                yield f"`{member}`: as of [{described[kind]}](#{anchor(described[kind])}).\n"
            elif kind is not None and kind is not status.Status:
                described[kind] = topic.name
                yield f"`{member}`:\n"
                yield from keys(kind)
                yield ""
        if topic.name in recorded:
            yield from example(json.loads(recorded[topic.name]))


def method_rows() -> Iterator[str]:
    """Yield the table of methods."""
    yield "| method | parameters | role | background | does |\n| --- | --- | --- | --- | --- |"
    for method in methods.METHODS:
        names = ", ".join(f"`{field.name}`" for field in msgspec.structs.fields(method.params))
        background = "yes" if method.background else ""
        yield f"| [`{method.name}`](#{anchor(method.name)}) | {names} | {method.role} | {background} | {method.text} |"


def method_sections() -> Iterator[str]:
    """Yield parameters, result and examples of each method."""
    recorded = exchanges()
    described: dict[Any, str] = {}
    for method in methods.METHODS:
        yield f"### {method.name}\n"
        if msgspec.structs.fields(method.params):
            yield "Parameters:\n"
            yield from keys(method.params)
            yield ""
        shown: set[str] = set()
        for kind in structures(method.result):
            if kind in described:
                if not shown:
                    many = "" if kind is method.result else "list of "
                    yield f"Result: {many}`{kind.__name__}`, see [{described[kind]}](#{anchor(described[kind])}).\n"
            elif kind is not status.Status and kind is not status.Recorder and kind is not status.Mode:
                described[kind] = method.name
                yield f"{'Result' if not shown else f'`{kind.__name__}`'}:\n"
                yield from keys(kind)
                yield ""
                shown.add(kind.__name__)
            elif not shown:
                yield "Result: see [status keys](#status-keys).\n"
                break
        found = [row for row in recorded if row["request"]["method"] == method.name]
        for row in found[:1] + [row for row in found[1:] if "error" in row["response"]][:1]:
            yield from example(row["request"])
            yield from example(row["response"])


def status_sections() -> Iterator[str]:
    """Yield the keys of the status and of its members."""
    for kind in structures(status.Status):
        if kind is not status.Status:
            yield f"`{kind.__name__}`: {(kind.__doc__ or '').splitlines()[0]}\n"
        yield from keys(kind)
        yield ""


def keys(kind: type[msgspec.Struct], *, but: type[msgspec.Struct] | None = None) -> Iterator[str]:
    """Yield the table of a structure's keys."""
    left_out = {field.name for field in msgspec.structs.fields(but)} if but is not None else set()
    (_,), components = msgspec.json.schema_components([kind], ref_template="{name}")
    properties = components[kind.__name__].get("properties", {})
    required = components[kind.__name__].get("required", [])
    yield "| key | type | always | meaning |\n| --- | --- | --- | --- |"
    for name, schema in properties.items():
        if name not in left_out:
            always = "yes" if name in required or (issubclass(kind, wire.Header) and "default" in schema) else ""
            meaning = schema.get("description") or MEANINGS.get(name, "")
            yield f"| `{name}` | {type_name(schema)} | {always} | {meaning} |"


MEANINGS = {
    "kind": "of the message, see the topics",
    "v": "version of the format, 1",
    "seq": "clouds, previews: number of the trigger, modulo 2^32; status, log: counts from 1",
    "t_ns": "CLOCK_REALTIME; clouds: start of exposure",
    "session": "unique for each start of the daemon; numbers of two sessions are not comparable",
    "device": "name of the rig",
    "calibration": "sha256: and the digest of the calibration file",
    "parts": "one row for each part, in their order",
    "data": "body of messages without parts",
    "frame": "coordinate frame of the points: left (camera), or the name of outputs.frame",
    "unit": "mm",
    "width": "of the grid, pixels",
    "height": "of the grid, pixels",
    "stats": "statistics of the cloud",
    "name": "unique within the message",
    "dtype": "type of the elements",
    "shape": "slowest dimension first",
    "codec": "compression of the bytes",
    "scale": "value = stored * scale + offset; a stored 0 is unknown",
    "offset": "see scale",
    "media": "media type of a part that is a file",
}


def error_rows() -> Iterator[str]:
    """Yield the table of error codes."""
    yield "| code | meaning |\n| --- | --- |"
    yield from (f"| {code} | {text} |" for code, text in ERRORS.items())


def limit_rows() -> Iterator[str]:
    """Yield the table of limits."""
    yield "| limit | value |\n| --- | --: |"
    yield from (f"| {name} | {value} |" for name, value in LIMITS.items())


def refused_rows() -> Iterator[str]:
    """Yield the table of malformed messages."""
    from fringed.conformance.recorded import expected

    yield "| topic | reason |\n| --- | --- |"
    yield from (f"| `{row['topic']}` | {row['reason']} |" for row in expected()["refused"])


def example(value: Any) -> Iterator[str]:
    """Yield a message as a block of JSON, long texts and lists shortened."""
    kept = re.sub(_STRING, lambda text: text[0].replace(" ", _SPACE), json.dumps(shortened(value), ensure_ascii=False))
    lines = textwrap.wrap(kept, _WIDTH, break_long_words=False, break_on_hyphens=False)
    yield "\n".join(["```json", *(line.replace(_SPACE, " ") for line in lines), "```", ""])


def shortened(value: Any, depth: int = 0) -> Any:
    """Return a value with the beginnings of long texts, lists and deep objects."""
    if isinstance(value, str):
        return value if len(value) <= _TEXT else f"{value[:_TEXT]}..."
    if isinstance(value, list):
        return [shortened(item, depth + 1) for item in value[:_ROWS]] + (["..."] if len(value) > _ROWS else [])
    if isinstance(value, dict):
        items = list(value.items())
        kept = items if depth < 3 else items[:_ROWS]
        more = {"...": "..."} if len(items) > len(kept) else {}
        return {key: shortened(item, depth + 1) for key, item in kept} | more
    return value


def structures(kind: Any) -> list[type[msgspec.Struct]]:
    """Return a structure and those in it, outermost first."""
    found: list[type[msgspec.Struct]] = []

    def visit(info: Any) -> None:
        if isinstance(info, msgspec.inspect.StructType):
            if info.cls not in found:
                found.append(info.cls)
                for field in info.fields:
                    visit(field.type)
            return
        for name in ("type", "item_type", "value_type"):
            if (inner := getattr(info, name, None)) is not None:
                visit(inner)
        for inner in getattr(info, "types", ()):
            visit(inner)

    visit(msgspec.inspect.type_info(kind))
    return found


def type_name(schema: dict[str, Any]) -> str:
    """Return the type of a key as shown in a table."""
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(type_name(branch) for branch in schema["anyOf"]))
    if "$ref" in schema:
        return f"`{schema['$ref']}`"
    kind = schema.get("type", "any")
    if kind == "array":
        items: Any = schema.get("items") or next(iter(schema.get("prefixItems", [])), {})
        return f"list of {type_name(items)}" if isinstance(items, dict) and items else "list"
    if kind == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"object of {type_name(schema['additionalProperties'])}"
    return str(kind)


def anchor(heading: str) -> str:
    """Return the anchor that GitHub gives to a heading."""
    return re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")


def main(arguments: list[str]) -> int:
    """Write the files; with ``--check``, report those that are not up to date."""
    stale = [path for path, text in files().items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    if "--check" in arguments:
        sys.stdout.writelines(f"{path.relative_to(ROOT)} is not up to date: make protocol\n" for path in stale)
        return int(bool(stale))
    for path in stale:
        path.parent.mkdir(exist_ok=True)
        path.write_text(files()[path], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
