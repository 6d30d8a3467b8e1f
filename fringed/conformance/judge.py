"""Comparison of a client's results with the expected ones."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

TOLERANCE_MM = 0.01
"""For computed coordinates; decoded parts must agree to the last bit."""


def problems(results: Iterable[str], expected: dict[str, Any]) -> list[str]:
    """Return what is missing or wrong in a client's results, empty for a conforming client.

    Args:
        results: lines of JSON, in any order, see docs/reference/protocol.md; the same message may come several times.
    """
    found: list[str] = []
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(results, 1):
        if line.strip():
            try:
                row = json.loads(line)
                rows.append(row if isinstance(row, dict) else {})
            except ValueError as error:
                found.append(f"line {number} is not JSON: {error}")
    received = {(row.get("topic"), _number(row)): row for row in rows if "parts" in row}
    refused = {row.get("topic") for row in rows if "error" in row}
    calls = {_request(row): row for row in rows if "method" in row}
    for message in expected["messages"]:
        found += _message(message, received)
    for message in expected["refused"]:
        topic = message["topic"]
        if any(key[0] == topic for key in received):
            found.append(f"{topic}: accepted, but {message['reason']}")
        elif topic not in refused:
            found.append(f"{topic}: no error was reported; {message['reason']}")
    for exchange in expected["control"]:
        found += _exchange(exchange, calls)
    return found


def _message(expected: dict[str, Any], received: dict[Any, dict[str, Any]]) -> list[str]:
    where = f"{expected['topic']} {_number(expected)}"
    row = received.get((expected["topic"], _number(expected)))
    if row is None:
        return [f"{where}: not received"]
    found = [
        f"{where}: header.{key} is {row.get('header', {}).get(key)!r}, expected {value!r}"
        for key, value in expected["header"].items()
        if row.get("header", {}).get(key) != value
    ]
    for name, part in expected["parts"].items():
        other = row["parts"].get(name)
        if other != part:
            found.append(f"{where}: part {name} is {other}, expected {part}")
    if "points" in expected:
        if row.get("points") != expected["points"]:
            found.append(f"{where}: {row.get('points')} points, expected {expected['points']}")
        mean = row.get("mean_mm") or [math.nan] * 3
        if any(not abs(a - b) <= TOLERANCE_MM for a, b in zip(mean, expected["mean_mm"], strict=True)):
            found.append(f"{where}: mean point {mean} mm, expected {expected['mean_mm']} within {TOLERANCE_MM}")
    return found


def _exchange(expected: dict[str, Any], calls: dict[str, dict[str, Any]]) -> list[str]:
    where = f"{expected['method']} {json.dumps(expected['params'])}"
    row = calls.get(_request(expected))
    if row is None:
        return [f"{where}: not called"]
    if "code" in expected:
        code = (row.get("error") or {}).get("code") if isinstance(row.get("error"), dict) else None
        return [] if code == expected["code"] else [f"{where}: error code {code}, expected {expected['code']}"]
    return [] if row.get("result") == expected["result"] else [f"{where}: another result than the recorded one"]


def _number(row: dict[str, Any]) -> Any:
    return row.get("header", {}).get("seq")


def _request(row: dict[str, Any]) -> str:
    return json.dumps([row.get("method"), row.get("params", {})], sort_keys=True)
