"""Pictures that the projector shows one after the other on a scene at rest, as descriptions and as pixels.

Two kinds of frames beside :class:`pipeline.pattern.ColorFringe`: an even picture in drive values, as it is sent to the
projector (its response may be what is asked for), and one fringe in light, the same in every channel that is lit.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence as Items
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import Response
from pipeline.errors import PatternError
from pipeline.pattern import ColorFringe
from pipeline.pattern import from_mapping as fringe_from_mapping

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Axis = Literal["x", "y"]

CHANNELS = ("red", "green", "blue")
LARGEST_SIDE = 8192
MOST_FRAMES = 512
_LONGEST_NAME = 64

WHITE_LEVEL = 192
"""Drive value of white: with all three channels lit, crosstalk makes a white board brighter than a colour fringe."""
GREY_MEAN, GREY_AMPLITUDE = 100.0, 92.0
"""Light of a fringe that is lit in all channels, for the same reason."""


@dataclass(frozen=True, slots=True)
class Uniform:
    """The same colour everywhere.

    Args:
        size: (width, height) of the projector, pixels.
        color: drive values of red, green and blue, whole numbers from 0 to 255, sent as they are.
    """

    size: tuple[int, int]
    color: tuple[int, int, int]

    def __post_init__(self) -> None:
        check_size(self.size)
        if len(self.color) != 3 or any(level not in range(256) for level in self.color):
            raise PatternError(f"pattern.color is {self.color!r:.80}, expected three whole numbers from 0 to 255")

    def picture(self, response: Response | None = None) -> Picture:  # noqa: ARG002 (drive values: as they are)
        """The picture to send, (height, width, 3) uint8, whatever the response is."""
        return np.full((*self.size[::-1], 3), self.color, np.uint8)

    def as_mapping(self) -> dict[str, Any]:
        """The JSON object of this frame."""
        return {"kind": "uniform", "size": list(self.size), "color": list(self.color)}


@dataclass(frozen=True, slots=True)
class Fringe:
    """One fringe, ``mean + amplitude cos(2 pi periods (u + 1/2) / length + shift)`` in light, 0..255.

    Args:
        size: (width, height) of the projector, pixels.
        periods: over the width (axis x) or the height (axis y); may be fractional.
        axis: direction along which the phase grows.
        shift: radians.
        mean, amplitude: light, 255 = full.
        channels: those that are lit, of red, green, blue; the others are dark.
    """

    size: tuple[int, int]
    periods: float
    axis: Axis = "x"
    shift: float = 0.0
    mean: float = GREY_MEAN
    amplitude: float = GREY_AMPLITUDE
    channels: tuple[str, ...] = CHANNELS

    def __post_init__(self) -> None:
        check_size(self.size)
        if self.axis not in ("x", "y"):
            raise PatternError(f"pattern.axis is {self.axis!r:.80}, expected 'x' or 'y'")
        if not 0 < self.periods <= self.length / 2:
            raise PatternError(f"pattern.periods is {self.periods}, expected more than 0 and at most {self.length / 2}")
        if not np.isfinite(self.shift):
            raise PatternError(f"pattern.shift is {self.shift}, expected a finite angle in radians")
        if not (0 < self.amplitude <= self.mean and self.mean + self.amplitude <= 255.0):
            raise PatternError(
                f"pattern.mean {self.mean} and amplitude {self.amplitude} leave 0..255; lower the amplitude"
            )
        lit = tuple(name for name in CHANNELS if name in self.channels)
        if not lit or len(lit) != len(self.channels):
            raise PatternError(
                f"pattern.channels is {list(self.channels)!r:.80}, expected one to three different ones of "
                f"{', '.join(CHANNELS)}"
            )
        object.__setattr__(self, "channels", lit)

    @property
    def length(self) -> int:
        """Number of projector columns (axis x) or rows (axis y)."""
        return self.size[0] if self.axis == "x" else self.size[1]

    @property
    def phase(self) -> Array:
        """Absolute phase at the centre of every column (or row) without the shift, (length,), radians."""
        return 2 * np.pi * self.periods * (np.arange(self.length) + 0.5) / self.length

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Which of the three channels are lit, (3,)."""
        return np.array([name in self.channels for name in CHANNELS])

    def light(self) -> Array:
        """Ideal light of the picture, (height, width, 3), 0..255."""
        return self._spread(self._wave()[:, None] * self.lit)

    def picture(self, response: Response | None = None) -> Picture:
        """The picture to send, (height, width, 3) uint8, pre-distorted so that its light is :meth:`light`."""
        line = np.repeat(self._wave()[:, None], 3, axis=1)
        drive = line if response is None else response.drive(line)
        # A dark channel gets drive 0, not the largest drive that still gives no light.
        return np.ascontiguousarray(self._spread(np.rint(drive * self.lit).astype(np.uint8)))

    def as_mapping(self) -> dict[str, Any]:
        """The JSON object of this frame."""
        out: dict[str, Any] = {"kind": "fringe", "size": list(self.size), "periods": self.periods, "axis": self.axis}
        out |= {"mean": self.mean, "amplitude": self.amplitude, "shift": self.shift}
        return out | {"channels": list(self.channels)}

    def _wave(self) -> Array:
        return np.asarray(self.mean + self.amplitude * np.cos(self.phase + self.shift))

    def _spread(self, line: NDArray[Any]) -> NDArray[Any]:
        """A line along the axis, (length, 3), all over the picture, (height, width, 3)."""
        return np.broadcast_to(line[None] if self.axis == "x" else line[:, None], (*self.size[::-1], 3))


Frame: TypeAlias = Uniform | Fringe | ColorFringe


@dataclass(frozen=True, slots=True)
class Sequence:
    """Frames in the order in which they are shown; all of one size.

    Args:
        name: what it is for, one word or a few, at most 64 characters.
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


def from_mapping(data: Mapping[str, Any]) -> Sequence:
    """The sequence of a JSON object; errors name the key."""
    if not isinstance(data, Mapping) or data.get("kind") != "sequence":
        kind = data.get("kind") if isinstance(data, Mapping) else data
        raise PatternError(f"pattern.kind is {kind!r:.80}, expected 'sequence'")
    frames = data.get("frames")
    if not isinstance(frames, Items) or isinstance(frames, str | bytes):
        raise PatternError("pattern.frames is missing or not a list")
    if not 1 <= len(frames) <= MOST_FRAMES:
        raise PatternError(f"pattern.frames holds {len(frames)} frames, expected 1 to {MOST_FRAMES}")
    return Sequence(data.get("name", ""), tuple(_frame_at(index, item) for index, item in enumerate(frames)))


def frame_from_mapping(data: Mapping[str, Any]) -> Frame:
    """The frame of a JSON object (kinds uniform, fringe, color_fringe); errors name the key."""
    if not isinstance(data, Mapping):
        raise PatternError(f"pattern is {data!r:.80}, expected an object with a kind")
    kind = data.get("kind")
    if kind == "color_fringe":
        frame: Frame = fringe_from_mapping(data)
        check_size(frame.size)
        return frame
    if kind not in ("uniform", "fringe"):
        raise PatternError(f"pattern.kind is {kind!r:.80}, expected 'uniform', 'fringe' or 'color_fringe'")
    try:
        width, height = (_whole(n, "size") for n in data["size"])
        if kind == "uniform":
            red, green, blue = (_whole(n, "color") for n in data["color"])
            return Uniform((width, height), (red, green, blue))
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


def check_size(size: tuple[int, int]) -> None:
    """PatternError unless both sides are whole numbers of pixels from 1 to 8192."""
    if len(size) != 2 or any(side not in range(1, LARGEST_SIDE + 1) for side in size):
        raise PatternError(f"pattern.size is {size!r:.80}, expected [width, height], 1 to {LARGEST_SIDE} pixels each")


def camera_sequence(size: tuple[int, int]) -> Sequence:
    """For the cameras' calibration: white light that clips no channel of a well exposed camera."""
    return Sequence("cameras", (Uniform(size, (WHITE_LEVEL,) * 3),))


def projector_sequence(size: tuple[int, int], *, finest_px: float = 12.8, steps: int = 6) -> Sequence:
    """For the projector's calibration: white, black, and grey fringes of three frequencies in x and in y.

    The steps are chosen for a projector whose response is not known yet. A fringe of n steps is blind to harmonics up
    to n - 2. With gamma 2.2 the second harmonic turns a phase of three steps by up to 0.29 rad, the third one of four
    steps by 0.011 rad: one period in three steps is good for telling 6 periods apart, and these in four steps for
    telling the finest ones apart. Six steps leave the fifth harmonic, 0.0004 rad or 0.001 px.

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
    return Sequence("projector", tuple(frames))


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
