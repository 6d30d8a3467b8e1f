"""calibration.yaml: read with line numbers in its errors, identified by its bytes, written whole."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import yaml
from yaml.constructor import SafeConstructor

from daemon.common.files import read_at_most, write_atomically
from daemon.config.yaml_source import in_c
from daemon.rig.camera_serials import Serials
from pipeline.common.errors import CalibrationError
from pipeline.rig import calibration as model
from pipeline.rig.calibration import Calibration, Cameras

SIZE_LIMIT = 4 << 20
VALUES_LIMIT = 1 << 20

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFile:
    """A calibration with the file it came from.

    Args:
        identity: ``sha256:`` and the digest of ``data``; part of every cloud's header.
        data: the file byte for byte; mapping: its plain content, unknown keys included.
    """

    calibration: Calibration
    identity: str
    data: bytes
    mapping: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class CamerasFile:
    """The same for a file that may have no projector yet."""

    cameras: Cameras
    identity: str
    data: bytes
    mapping: dict[str, Any]


def read_calibration(path: Path) -> CalibrationFile:
    """Read a calibration file.

    Raises:
        CalibrationError: it cannot be read or used; the message begins with the file's name.
    """
    return parse_calibration(read_at_most(path, SIZE_LIMIT, CalibrationError), str(path))


def parse_calibration(data: bytes, name: str) -> CalibrationFile:
    """The calibration in the bytes of a file; ``name`` stands for it in errors.

    Raises:
        CalibrationError: syntax as ``name:line:column``, content as ``name: key``.
    """
    mapping = load_mapping(data, name)
    return CalibrationFile(_named(name, lambda: model.from_mapping(mapping)), identity(data), data, mapping)


def created_at(mapping: Mapping[str, Any]) -> datetime | None:
    """The date in a calibration file, None where it has none."""
    created = mapping.get("created")
    try:
        stamp = created if isinstance(created, datetime) else datetime.fromisoformat(str(created))
    except ValueError:
        return None
    return stamp if stamp.tzinfo is not None else stamp.replace(tzinfo=UTC)


def read_cameras(path: Path) -> CamerasFile:
    """Read a calibration file whose projector may be missing, as :func:`read_calibration` does."""
    return parse_cameras(read_at_most(path, SIZE_LIMIT, CalibrationError), str(path))


def parse_cameras(data: bytes, name: str) -> CamerasFile:
    """The same as :func:`parse_calibration` for a file whose projector may be missing."""
    mapping = load_mapping(data, name)
    return CamerasFile(_named(name, lambda: model.cameras_from_mapping(mapping)), identity(data), data, mapping)


def identity(data: bytes) -> str:
    """``sha256:`` and the hex digest of a file's bytes."""
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def _named(name: str, make: Callable[[], T]) -> T:
    try:
        return make()
    except CalibrationError as error:
        raise CalibrationError(f"{name}: {error}") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise CalibrationError(f"{name}: not a calibration: {error}") from error


def write_calibration(
    path: Path,
    calibration: Calibration,
    *,
    created: datetime | None = None,
    quality: Mapping[str, Any] | None = None,
    keep: Mapping[str, Any] | None = None,
) -> CalibrationFile:
    """Write a calibration file, whole or not at all.

    Args:
        created: when it was measured; now if None.
        quality: free: rms errors, number of views.
        keep: mapping of the file that this one replaces; its unknown keys are kept.
    """
    data = calibration_bytes(calibration, created=created, quality=quality, keep=keep)
    file = parse_calibration(data, str(path))
    write_atomically(Path(path), data)
    return file


def calibration_bytes(
    calibration: Calibration | Cameras,
    *,
    created: datetime | None = None,
    quality: Mapping[str, Any] | None = None,
    keep: Mapping[str, Any] | None = None,
    serials: Serials | None = None,
) -> bytes:
    """The bytes that :func:`write_calibration` writes; ``serials``: of the cameras, instead of those to keep."""
    stamp = (created or datetime.now(UTC)).astimezone(UTC)
    ours = model.to_mapping(calibration)
    head = {"fringed_calibration": ours.pop("fringed_calibration"), "created": stamp.strftime("%Y-%m-%dT%H:%M:%SZ")}
    mapping = head | ours | ({"quality": dict(quality)} if quality is not None else {})
    for side, serial in (serials or {}).items():
        mapping["cameras"][side] = {"serial": serial} | mapping["cameras"][side]
    if keep is not None:
        _keep_unknown(mapping, keep)
    return yaml.safe_dump(mapping, sort_keys=False, default_flow_style=None, width=120).encode()


# Optional parts that a new calibration may leave out on purpose: they must not come back from the old file.
_NOT_KEPT = {"response", "registration", "color", "lateral", "balance", "projector"}


def _keep_unknown(new: dict[str, Any], old: Mapping[str, Any]) -> None:
    for key, value in old.items():
        if key not in new and key not in _NOT_KEPT:
            new[key] = copy.deepcopy(value)
        elif key != "quality" and isinstance(new.get(key), dict) and isinstance(value, Mapping):
            _keep_unknown(new[key], value)


class _KeysOnce(SafeConstructor):
    """Rejects duplicate keys, of which YAML would silently use the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key is not None and key in seen:
                raise yaml.MarkedYAMLError(problem=f"the key {key!r} is there twice", problem_mark=key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


class _Loader(_KeysOnce, yaml.SafeLoader):
    pass


class _CLoader(_KeysOnce, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    pass


def load_mapping(data: bytes, name: str) -> dict[str, Any]:
    """Keys and values of a YAML file: safe, no key twice, no aliases that unfold without end; CalibrationError."""
    try:
        mapping = yaml.load(data, Loader=_CLoader if in_c(data) else _Loader)  # noqa: S506  (both are safe)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise CalibrationError(f"{name}{place}: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise CalibrationError(f"{name}: not YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise CalibrationError(f"{name}: nested too deeply for a calibration") from error
    if _unfolded(mapping, {}) > VALUES_LIMIT:
        raise CalibrationError(f"{name}: its aliases unfold to more than {VALUES_LIMIT} values")
    if not isinstance(mapping, dict):
        raise CalibrationError(f"{name}: expected keys and values, got {type(mapping).__name__}")
    return mapping


def _unfolded(value: Any, counts: dict[int, int]) -> int:
    """Number of values with every alias written out; one that holds itself counts as too many."""
    if not isinstance(value, dict | list):
        return 1
    if id(value) not in counts:
        counts[id(value)] = VALUES_LIMIT + 1
        inner = value.values() if isinstance(value, dict) else value
        counts[id(value)] = 1 + sum(_unfolded(item, counts) for item in inner)
    return counts[id(value)]
