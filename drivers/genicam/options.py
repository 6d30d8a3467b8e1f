"""Options of a GenICam camera in the rig file, checked before any camera is opened."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from drivers.protocols import Side

PRODUCER_PATH = "GENICAM_GENTL64_PATH"
"""Environment variable of the GenTL standard: directories with producers, separated by colons."""

Name = Annotated[str, Meta(min_length=1, max_length=128)]
Value = bool | int | float | str


class Trigger(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The trigger of an exposure.

    Args:
        source: an electrical line of the camera; or for tests ``software`` (the driver triggers, ``rate_hz`` times a
            second) and ``free_run`` (the camera triggers itself).
        line: its name; edge: of the pulse; selector: what the pulse starts; delay_us: between pulse and exposure.
        inverted: the camera's line inverter.
    """

    source: Literal["line", "software", "free_run"] = "line"
    line: Name = "Line1"
    edge: Literal["rising", "falling"] = "rising"
    selector: Name = "FrameStart"
    delay_us: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    inverted: bool = False
    rate_hz: Annotated[float, Meta(gt=0, le=1000)] = 10.0


class Roi(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The part of the sensor that is read, pixels."""

    width: Annotated[int, Meta(gt=0, le=65536)]
    height: Annotated[int, Meta(gt=0, le=65536)]
    x: Annotated[int, Meta(ge=0, le=65536)] = 0
    y: Annotated[int, Meta(ge=0, le=65536)] = 0


class Options(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """One camera of the rig file.

    Args:
        producer: GenTL producers (.cti files); None: those of GENICAM_GENTL64_PATH.
        serial, model, user_name: identify the camera; together they must match exactly one.
        exposure_us: fixed exposure time; gain: in the camera's unit; each as the camera has it if None.
        pixel_format: its PFNC name. roi: the whole sensor if None.
        buffers: images that the transport may fill while the driver is busy.
        features: further features by name, set last.
        timestamp_offset_us: added to the camera's time stamp to get the start of the exposure, for cameras that stamp
            another moment.
        read_timeout_s: silence after which the connection is checked.
        open_timeout_s: limit for opening.
    """

    producer: Name | list[Name] | None = None
    serial: Name | None = None
    model: Name | None = None
    user_name: Name | None = None
    trigger: Trigger = Trigger()
    exposure_us: Annotated[float, Meta(gt=0, le=1e8)] | None = None
    gain: Annotated[float, Meta(ge=-100, le=1e5)] | None = None
    pixel_format: Name | None = None
    roi: Roi | None = None
    buffers: Annotated[int, Meta(ge=3, le=256)] = 16
    features: Annotated[dict[str, Value], Meta(max_length=64)] = {}
    timestamp_offset_us: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0
    read_timeout_s: Annotated[float, Meta(gt=0, le=60)] = 0.5
    open_timeout_s: Annotated[float, Meta(gt=0, le=600)] = 60.0


def parse(side: Side, options: Mapping[str, Any]) -> Options:
    """Check options; ValueError names the key as ``cameras.<side>.<key>``."""
    section = f"cameras.{side}"
    try:
        parsed = msgspec.convert(dict(options), Options, strict=True)
    except msgspec.ValidationError as error:
        text, _, path = str(error).partition(" - at `$")
        raise ValueError(f"{_key(section, text, path.rstrip('`'))}: {text}") from error
    if parsed.serial is None and parsed.model is None and parsed.user_name is None:
        raise ValueError(f"{section}.serial: name the camera by its serial, model or user_name")
    for name, value in (("exposure_us", parsed.exposure_us), ("gain", parsed.gain)):
        if value is not None and not abs(value) < float("inf"):
            raise ValueError(f"{section}.{name}: {value} is not a finite number")
    return parsed


def _key(section: str, text: str, path: str) -> str:
    """Return the path of the key; msgspec names an unknown key in the text only."""
    _, quoted, name = text.partition("unknown field `")
    return section + path.replace("[...]", "") + (f".{name.rstrip('`')}" if quoted else "")


def producers(named: str | list[str] | None, base_dir: Path, environ: Mapping[str, str] = os.environ) -> list[Path]:
    """Return the .cti files to load; ValueError without any, FileNotFoundError where a named one does not exist."""
    if named:
        paths = [base_dir / Path(name).expanduser() for name in ([named] if isinstance(named, str) else named)]
        for path in paths:
            if not path.is_file():
                raise FileNotFoundError(
                    f"there is no GenTL producer {path}; install the camera vendor's, or name its .cti"
                )
        return paths
    directories = [Path(part) for part in environ.get(PRODUCER_PATH, "").split(os.pathsep) if part]
    paths = sorted(path for directory in directories if directory.is_dir() for path in directory.glob("*.cti"))
    if not paths:
        raise ValueError(
            f"no GenTL producer: set producer to the vendor's .cti file, or {PRODUCER_PATH} to its directory"
        )
    return paths
