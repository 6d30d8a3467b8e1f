"""pattern.json and volume.json: read with a bound on their size and errors that name the file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from daemon.common.files import read_at_most
from pipeline.common.errors import PatternError, PipelineError
from pipeline.pattern.color_fringe import ColorFringe, from_mapping
from pipeline.pattern.sequence import FrameSequence
from pipeline.pattern.sequence import from_mapping as sequence_from_mapping
from pipeline.rig.volume import Volume

PATTERN_LIMIT = 4 << 20
VOLUME_LIMIT = 1 << 16

T = TypeVar("T")


def read_pattern(path: Path) -> ColorFringe:
    """Read a pattern file; PatternError names the file and the key."""
    return parse_pattern(read_at_most(path, PATTERN_LIMIT, PatternError), str(path))


def parse_pattern(data: bytes, name: str) -> ColorFringe:
    """The pattern in the bytes of a file; ``name`` stands for it in errors."""
    return _named(name, PatternError, lambda: from_mapping(_object(data, name, PatternError)))


def parse_sequence(data: bytes, name: str) -> FrameSequence | None:
    """The sequence in the bytes of a file, None where it holds a single pattern; ``name`` stands for it in errors."""
    values = _object(data, name, PatternError)
    if values.get("kind") != "sequence":
        return None
    return _named(name, PatternError, lambda: sequence_from_mapping(values))


def read_volume(path: Path) -> Volume:
    """Read a volume file; PipelineError names the file and the key."""
    return parse_volume(read_at_most(path, VOLUME_LIMIT, PipelineError), str(path))


def parse_volume(data: bytes, name: str) -> Volume:
    """The measuring volume in the bytes of a file; ``name`` stands for it in errors."""
    return _named(name, PipelineError, lambda: _volume(_object(data, name, PipelineError)))


def _volume(values: Mapping[str, Any]) -> Volume:
    limits = []
    for key in ("near_mm", "far_mm"):
        value = values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise PipelineError(f"{key} is {value!r:.80}, expected a number of millimetres")
        limits.append(float(value))
    return Volume(*limits)


def _object(data: bytes, name: str, error: type[PipelineError]) -> dict[str, Any]:
    try:
        value = json.loads(data)
    except json.JSONDecodeError as problem:
        raise error(f"{name}:{problem.lineno}:{problem.colno}: {problem.msg}") from problem
    except (ValueError, RecursionError) as problem:
        raise error(f"{name}: not JSON: {problem}") from problem
    if not isinstance(value, dict):
        raise error(f"{name}: expected a JSON object, got {type(value).__name__}")
    return value


def _named(name: str, error: type[PipelineError], make: Callable[[], T]) -> T:
    try:
        return make()
    except PipelineError as problem:
        text = str(problem)
        raise error(text if text.startswith(name) else f"{name}: {text}") from problem
    except (ValueError, TypeError, OverflowError) as problem:
        raise error(f"{name}: {problem}") from problem
