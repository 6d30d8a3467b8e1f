"""Sequences of frames that the projector shows on a scene at rest, and their JSON descriptions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from pipeline.common.errors import PatternError
from pipeline.pattern.color_fringe import ColorFringe, items, read_field
from pipeline.pattern.color_fringe import from_mapping as fringe_from_mapping
from pipeline.pattern.projected_frames import (
    CHANNELS,
    GRAY_AMPLITUDE,
    GRAY_MEAN,
    Axis,
    Fringe,
    GrayBit,
    Uniform,
    check_size,
)

MOST_FRAMES = 512
_LONGEST_NAME = 64

WHITE_LEVEL = 192
"""Drive value of white: with all three channels lit, crosstalk makes a white board brighter than a colour fringe."""

Frame: TypeAlias = Uniform | Fringe | GrayBit | ColorFringe


@dataclass(frozen=True, slots=True)
class FrameSequence:
    """Frames in the order in which they are shown; all of one size.

    Args:
        name: its purpose, one word or a few, at most 64 characters.
        frames: 1 to 512.
    """

    name: str
    frames: tuple[Frame, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "frames", tuple(self.frames))
        if not (isinstance(self.name, str) and 0 < len(self.name) <= _LONGEST_NAME and self.name.isprintable()):
            raise PatternError(f"pattern.name is {self.name!r:.80}, expected 1 to {_LONGEST_NAME} printable characters")
        if not 1 <= len(self.frames) <= MOST_FRAMES:
            raise PatternError(f"pattern.frames holds {len(self.frames)} frames, expected 1 to {MOST_FRAMES}")
        check_size(self.size)
        for index, frame in enumerate(self.frames):
            if frame.size != self.size:
                raise PatternError(
                    f"pattern.frames[{index}].size is {list(frame.size)}, but the first frame's is {list(self.size)}"
                )

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the projector, pixels."""
        return self.frames[0].size

    def as_mapping(self) -> dict[str, Any]:
        """The JSON object of the sequence."""
        return {"kind": "sequence", "name": self.name, "frames": [frame.as_mapping() for frame in self.frames]}


def from_mapping(data: Mapping[str, Any]) -> FrameSequence:
    """The sequence of a JSON object; errors name the key."""
    if not isinstance(data, Mapping) or data.get("kind") != "sequence":
        kind = data.get("kind") if isinstance(data, Mapping) else data
        raise PatternError(f"pattern.kind is {kind!r:.80}, expected 'sequence'")
    frames = data.get("frames")
    if not isinstance(frames, Sequence) or isinstance(frames, str | bytes):
        raise PatternError("pattern.frames is missing or not a list")
    if not 1 <= len(frames) <= MOST_FRAMES:
        raise PatternError(f"pattern.frames holds {len(frames)} frames, expected 1 to {MOST_FRAMES}")
    return FrameSequence(data.get("name", ""), tuple(_frame_at(index, item) for index, item in enumerate(frames)))


def frame_from_mapping(data: Mapping[str, Any]) -> Frame:
    """The frame of a JSON object (kinds uniform, fringe, gray, color_fringe); errors name the key."""
    if not isinstance(data, Mapping):
        raise PatternError(f"pattern is {data!r:.80}, expected an object with a kind")
    kind = data.get("kind")
    if kind == "color_fringe":
        frame: Frame = fringe_from_mapping(data)
        check_size(frame.size)
        return frame
    if kind not in ("uniform", "fringe", "gray"):
        raise PatternError(f"pattern.kind is {kind!r:.80}, expected 'uniform', 'fringe', 'gray' or 'color_fringe'")
    width, height = read_field(data, "size", _whole_numbers(2), "width and height, whole numbers of pixels")
    if kind == "uniform":
        red, green, blue = read_field(data, "color", _whole_numbers(3), "three whole numbers")
        return Uniform((width, height), (red, green, blue))
    optional: dict[str, Any] = {"axis": "x", "channels": CHANNELS}
    if kind == "gray":
        optional |= {"inverted": False, "cells": 0.0, "mean": GRAY_MEAN, "amplitude": GRAY_AMPLITUDE}
    required = ("bit", "bits") if kind == "gray" else ("periods", "shift", "mean", "amplitude")
    data = optional | dict(data)
    values = {key: read_field(data, key, *_VALUES[key]) for key in (*required, *optional)}
    return GrayBit((width, height), **values) if kind == "gray" else Fringe((width, height), **values)


def camera_sequence(size: tuple[int, int]) -> FrameSequence:
    """For the cameras' calibration: white light that saturates no channel of a well exposed camera."""
    return FrameSequence("cameras", (Uniform(size, (WHITE_LEVEL,) * 3),))


def projector_sequence(size: tuple[int, int], *, finest_px: float = 12.8, steps: int = 6) -> FrameSequence:
    """For the projector's calibration: white, black, and grey fringes of three frequencies in x and in y.

    The steps are chosen for an uncalibrated response of the projector. A fringe of n steps is insensitive to harmonics
    up to n - 2. With gamma 2.2 the second harmonic changes a phase of three steps by up to 0.29 rad, the third one of
    four steps by 0.011 rad: one period in three steps distinguishes 6 periods, and these in four steps the finest
    ones. Six steps leave the fifth harmonic, 0.0004 rad or 0.001 px.

    Args:
        size: (width, height) of the projector, pixels.
        finest_px: period of the finest fringe, projector pixels.
        steps: of the finest fringe, at least 4; its noise goes with 1 / sqrt(steps).
    """
    check_size(size)
    if not 4 <= steps <= 100:
        raise PatternError(f"steps is {steps}, expected 4 to 100")
    if not 4 <= finest_px <= min(size):
        raise PatternError(f"finest_px is {finest_px}, expected 4 to {min(size)}, the projector's shorter side")
    frames: list[Frame] = [Uniform(size, (WHITE_LEVEL,) * 3), Uniform(size, (0, 0, 0))]
    axes: tuple[Axis, ...] = ("x", "y")
    for axis, length in zip(axes, size, strict=True):
        finest = length / finest_px
        levels = [(1.0, 3), (6.0, 4), (finest, steps)] if finest > 6 else [(1.0, 4), (finest, steps)]
        frames += [
            Fringe(size, periods, axis, 2 * np.pi * n / count) for periods, count in levels for n in range(count)
        ]
    return FrameSequence("projector", tuple(frames))


def _frame_at(index: int, item: Any) -> Frame:
    try:
        return frame_from_mapping(item)
    except PatternError as error:
        raise PatternError(str(error).replace("pattern", f"pattern.frames[{index}]", 1)) from error


def _whole(value: Any) -> int:
    number = float(value)
    if not number.is_integer():
        raise ValueError(value)
    return int(number)


def _whole_numbers(count: int) -> Callable[[Any], list[int]]:
    return lambda value: [_whole(item) for item in items(value, count)]


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(value)
    return value


def _names(value: Any) -> tuple[str, ...]:
    if isinstance(value, str) or not all(isinstance(name, str) for name in value):
        raise TypeError(value)
    return tuple(value)


_VALUES: dict[str, tuple[Callable[[Any], Any], str]] = {
    **dict.fromkeys(("bit", "bits"), (_whole, "a whole number")),
    **dict.fromkeys(("periods", "shift", "mean", "amplitude", "cells"), (float, "a number")),
    "inverted": (_flag, "true or false"),
    "axis": (str, "'x' or 'y'"),
    "channels": (_names, "a list of names"),
}
"""How the values of a frame are read, and what is expected of them."""
