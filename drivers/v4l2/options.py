"""The options of one camera in rig.yaml, checked; every mistake is named by its key."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from drivers.protocols import Side
from drivers.v4l2 import formats

MAX_BUFFERS = 32
_MAX_SIDE = 16384


class Options(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One camera.

    Args:
        device: a path (/dev/v4l/by-id/... stays the same after a restart), or a serial number or bus of a camera.
        size: (width, height), pixels; the camera's own if None.
        format: four-letter code (YUYV, RGGB, GREY, MJPG, ...); the best one for measuring if None.
        frame_rate_hz: requested of the camera; unchanged if None.
        controls: by name, as ``v4l2-ctl --list-ctrls`` shows them; menus by number or name.
        buffers: frames that may wait in the kernel.
        trigger: ``hardware``: each exposure is started by a wire, which the camera's controls switch on;
            ``software``: the camera runs freely.
        only_still_scenes: must be true with ``trigger: software``.
        end_of_frame_delay_us: from the end of the exposure to the driver's time stamp (read-out), where the stamp is of
            the end of the frame.
    """

    device: str
    size: tuple[int, int] | None = None
    format: str | None = None
    frame_rate_hz: float | None = None
    controls: dict[str, bool | int | str] = {}
    buffers: int = 8
    trigger: Literal["hardware", "software"] = "hardware"
    only_still_scenes: bool = False
    end_of_frame_delay_us: float = 0.0


def from_mapping(side: Side, data: Mapping[str, Any]) -> Options:
    """Check options given as plain values.

    Raises:
        ValueError: ``cameras.<side>.<key>`` and its problem.
    """
    section = f"cameras.{side}"
    fields = Options.__struct_fields__
    for key in data:
        if key not in fields:
            near = difflib.get_close_matches(str(key), fields, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(fields)}"
            raise ValueError(f"{section}.{key}: there is no such option; {hint}")
    if "device" not in data:
        raise ValueError(f"{section}.device: is missing; write the camera's path (ls /dev/v4l/by-id) or serial number")
    try:
        options = msgspec.convert(dict(data), Options)
    except msgspec.ValidationError as error:
        message, _, path = str(error).partition(" - at `$")
        raise ValueError(f"{section}{path.rstrip('`')}: {_lower(message)}, got {_value_at(data, path)!r}") from error
    for key, problem in _problems(options):
        raise ValueError(f"{section}.{key}: {problem}")
    return options


def _problems(options: Options) -> list[tuple[str, str]]:
    problems = []
    if not options.device.strip():
        problems.append(("device", "is empty; write the camera's path (ls /dev/v4l/by-id) or serial number"))
    if options.size is not None and not all(16 <= side <= _MAX_SIDE and side % 2 == 0 for side in options.size):
        problems.append(
            ("size", f"is {list(options.size)}, expected two even numbers of pixels from 16 to {_MAX_SIDE}")
        )
    if options.format is not None and formats.named(options.format) is None:
        problems.append(("format", f"{options.format!r} is not supported; there are {', '.join(formats.FORMATS)}"))
    if options.frame_rate_hz is not None and not 0.01 <= options.frame_rate_hz <= 10_000:
        problems.append(("frame_rate_hz", f"is {options.frame_rate_hz}, expected 0.01 to 10000"))
    if not 2 <= options.buffers <= MAX_BUFFERS:
        problems.append(("buffers", f"is {options.buffers}, expected 2 to {MAX_BUFFERS}"))
    if not 0 <= options.end_of_frame_delay_us <= 1e6:
        problems.append(("end_of_frame_delay_us", f"is {options.end_of_frame_delay_us}, expected 0 to 1000000"))
    for name, value in options.controls.items():
        if isinstance(value, int) and not -(1 << 31) <= value < 1 << 31:
            problems.append((f"controls.{name}", f"is {value}, expected a number of 32 bits"))
    if options.trigger == "software" and not options.only_still_scenes:
        problems.append(
            (
                "trigger",
                "with 'software' each camera exposes by its own clock, so that a moving object is at another place in"
                " the right image than in the left one and is measured wrongly; trigger both cameras by hardware"
                " (trigger: hardware), or, if nothing ever moves, set only_still_scenes: true",
            )
        )
    return problems


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _value_at(data: Any, path: str) -> Any:
    """Return the value at a path such as ``.size[0]``, or the last one on the path that exists."""
    for part in path.rstrip("`").replace("[", ".[").split(".")[1:]:
        try:
            data = data[int(part[1:-1])] if part.startswith("[") else data[part]
        except (KeyError, IndexError, ValueError, TypeError):
            break
    return data
