"""YAML parsed to plain JSON values with the position of every key and value; duplicate keys and dates are errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import yaml

KeyPath = tuple[str | int, ...]
MAX_NODES = 20_000
MAX_DEPTH = 32
MOST_INDICATORS = 5_000
"""Brackets, dashes, colons and question marks up to which libyaml parses a text: each can begin a level, and its parser
recurses without a limit (20,000 levels are parsed, 200,000 exceed the stack and end the process)."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake: its position (line and column from 1) and a message."""

    line: int
    column: int
    message: str


@dataclass(slots=True)
class Source:
    """The values of a YAML text and their positions."""

    data: Any = None
    positions: dict[KeyPath, tuple[int, int]] = field(default_factory=dict)
    keys: dict[KeyPath, tuple[int, int]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    unreadable: set[KeyPath] = field(default_factory=set)

    def position(self, path: KeyPath, *, key: bool = False) -> tuple[int, int]:
        """Return line and column of a value (or of its key), else of the nearest enclosing value."""
        for length in range(len(path), -1, -1):
            table = self.keys if key and length == len(path) else self.positions
            if path[:length] in table:
                return table[path[:length]]
        return (1, 1)

    def add_problem(self, path: KeyPath, message: str, *, key: bool = False) -> None:
        """Add a problem at a path."""
        self.problems.append(Problem(*self.position(path, key=key), message))


def in_c(text: str | bytes) -> bool:
    """Whether libyaml, ten times as fast, can parse a text: it is there, and the text cannot exceed its stack."""
    raw = text.encode(errors="replace") if isinstance(text, str) else text
    return yaml.__with_libyaml__ and sum(map(raw.count, b"[{-?:")) <= MOST_INDICATORS


def read_yaml(text: str) -> Source:
    """Parse one YAML document; syntax errors and duplicate keys become problems."""
    source = Source()
    try:
        node = yaml.compose(text, Loader=yaml.CSafeLoader if in_c(text) else yaml.SafeLoader)
        if node is None:
            source.problems.append(Problem(1, 1, "the file is empty"))
        else:
            source.data = _Walk(source).value(node, ())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        source.problems.append(Problem(line, column, f"YAML syntax: {error.problem or error.context}"))
    except yaml.YAMLError as error:
        source.problems.append(Problem(1, 1, f"YAML syntax: {' '.join(str(error).split())}"))
    except RecursionError:
        source.problems.append(Problem(1, 1, "nested too deeply"))
    return source


class _Walk:
    def __init__(self, source: Source) -> None:
        self.source = source
        self.constructor = yaml.SafeLoader("")
        self.nodes = 0

    def value(self, node: yaml.Node, path: KeyPath) -> Any:
        position = (node.start_mark.line + 1, node.start_mark.column + 1)
        self.source.positions[path] = position
        self.nodes += 1
        if len(path) > MAX_DEPTH or self.nodes > MAX_NODES:
            raise yaml.YAMLError(f"more than {MAX_NODES} values or {MAX_DEPTH} levels")
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item, (*path, i)) for i, item in enumerate(node.value)]
        return self.scalar(node, path)

    def mapping(self, node: yaml.MappingNode, path: KeyPath) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            position = (key_node.start_mark.line + 1, key_node.start_mark.column + 1)
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag != "tag:yaml.org,2002:str":
                text = f"the key {key_node.value!r:.40} is not plain text; quote it"
                self.source.problems.append(Problem(*position, text))
                continue
            key = key_node.value
            if key in out:
                first = self.source.keys[(*path, key)][0]
                self.source.problems.append(
                    Problem(*position, f"the key {key!r} is defined twice, first in line {first}")
                )
                continue
            self.source.keys[(*path, key)] = position
            out[key] = self.value(value_node, (*path, key))
        return out

    def scalar(self, node: yaml.Node, path: KeyPath) -> Any:
        try:
            value = self.constructor.construct_object(node, deep=True)
        except (yaml.YAMLError, ValueError) as error:
            return self.unreadable(path, f"cannot be read: {' '.join(str(error).split()):.120}")
        if isinstance(value, float) and not math.isfinite(value):
            name = ".".join(str(part) for part in path) or "the file"
            return self.unreadable(path, f"{name}: {node.value} is not a finite number")
        if isinstance(value, bool | int | float | str) or value is None:
            return value
        return self.unreadable(path, f"{node.value!r:.60} reads as a {type(value).__name__}; put it in quotes")

    def unreadable(self, path: KeyPath, message: str) -> None:
        """Add a problem; the value becomes null, about which there are no further messages."""
        self.source.unreadable.add(path)
        self.source.add_problem(path, message)
