"""Sequences of frames that the projector shows on a scene at rest, and their JSON descriptions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from pipeline.common.errors import PatternError
from pipeline.pattern.color_fringe import ColorFringe
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
    try:
        width, height = (_whole(n, "size") for n in data["size"])
        if kind == "uniform":
            red, green, blue = (_whole(n, "color") for n in data["color"])
            return Uniform((width, height), (red, green, blue))
        if kind == "gray":
            return _gray_bit((width, height), data)
        return Fringe(
            (width, height),
            periods=float(data["periods"]),
            axis=data.get("axis", "x"),
            shift=float(data["shift"]),
            mean=float(data["mean"]),
            amplitude=float(data["amplitude"]),
            channels=_names(data.get("channels", CHANNELS)),
        )
    except KeyError as error:
        raise PatternError(f"pattern.{error.args[0]} is missing") from error
    except PatternError:
        raise
    except (TypeError, ValueError) as error:
        raise PatternError(f"pattern description: {error}") from error


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


def _gray_bit(size: tuple[int, int], data: Mapping[str, Any]) -> GrayBit:
    inverted = data.get("inverted", False)
    if not isinstance(inverted, bool):
        raise PatternError(f"pattern.inverted is {inverted!r:.80}, expected true or false")
    return GrayBit(
        size,
        bit=_whole(data["bit"], "bit"),
        bits=_whole(data["bits"], "bits"),
        inverted=inverted,
        axis=data.get("axis", "x"),
        cells=float(data.get("cells", 0.0)),
        mean=float(data.get("mean", GRAY_MEAN)),
        amplitude=float(data.get("amplitude", GRAY_AMPLITUDE)),
        channels=_names(data.get("channels", CHANNELS)),
    )


def _frame_at(index: int, item: Any) -> Frame:
    try:
        return frame_from_mapping(item)
    except PatternError as error:
        raise PatternError(str(error).replace("pattern", f"pattern.frames[{index}]", 1)) from error


def _whole(value: Any, key: str) -> int:
    number = float(value)
    if not number.is_integer():
        raise PatternError(f"pattern.{key} holds {value!r:.80}, expected whole numbers")
    return int(number)


def _names(value: Any) -> tuple[str, ...]:
    if isinstance(value, str) or not all(isinstance(name, str) for name in value):
        raise PatternError(f"pattern.channels is {value!r:.80}, expected a list of names")
    return tuple(value)
