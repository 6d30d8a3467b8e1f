"""Kinds of projected frames other than :class:`pipeline.pattern.color_fringe.ColorFringe`.

A uniform frame is given in drive values, since it may serve to measure the projector's response; a fringe and a bit of
a Gray code are given in light, the same in every lit channel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import PatternError
from pipeline.rig.calibration import Response

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Axis = Literal["x", "y"]

CHANNELS = ("red", "green", "blue")
LARGEST_SIDE = 8192
MOST_BITS = 13
GRAY_MEAN, GRAY_AMPLITUDE = 100.0, 92.0
"""Light of a fringe that is lit in all channels: crosstalk makes it brighter than a colour fringe."""


@dataclass(frozen=True, slots=True)
class Uniform:
    """A uniform colour.

    Args:
        size: (width, height) of the projector, pixels.
        color: drive values of red, green and blue, whole numbers from 0 to 255, sent unchanged.
    """

    size: tuple[int, int]
    color: tuple[int, int, int]

    def __post_init__(self) -> None:
        check_size(self.size)
        if len(self.color) != 3 or any(level not in range(256) for level in self.color):
            raise PatternError(f"pattern.color is {self.color!r:.80}, expected three whole numbers from 0 to 255")

    def image(self, response: Response | None = None) -> Image:  # noqa: ARG002 (drive values: as they are)
        """The image to send, (height, width, 3) uint8, whatever the response is."""
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
        channels: the lit ones of red, green, blue; the others are dark.
    """

    size: tuple[int, int]
    periods: float
    axis: Axis = "x"
    shift: float = 0.0
    mean: float = GRAY_MEAN
    amplitude: float = GRAY_AMPLITUDE
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
        """Ideal light of the image, (height, width, 3), 0..255."""
        return np.asarray(_spread(self._wave()[:, None] * self.lit, self.axis, self.size))

    def image(self, response: Response | None = None) -> Image:
        """The image to send, (height, width, 3) uint8, pre-distorted so that its light is :meth:`light`."""
        return _sent(self._wave(), self.lit, self.axis, self.size, response)

    def as_mapping(self) -> dict[str, Any]:
        """The JSON object of this frame."""
        out: dict[str, Any] = {"kind": "fringe", "size": list(self.size), "periods": self.periods, "axis": self.axis}
        out |= {"mean": self.mean, "amplitude": self.amplitude, "shift": self.shift}
        return out | {"channels": list(self.channels)}

    def _wave(self) -> Array:
        return np.asarray(self.mean + self.amplitude * np.cos(self.phase + self.shift))


@dataclass(frozen=True, slots=True)
class GrayBit:
    """One bit of a Gray code of the columns (axis x) or rows: ``mean + amplitude`` where it is 1, else ``mean -``.

    A column lies in cell ``floor(cells (u + 1/2) / length)``; the code of cell n is ``n ^ (n >> 1)`` (Gray, US patent
    2,632,058, 1953): from one cell to the next a single bit changes.

    Args:
        size: (width, height) of the projector, pixels.
        bit: which one, 0 = the most significant of ``bits``.
        bits: of the code, 1 to 13.
        inverted: 0 is bright instead of 1.
        axis: direction along which the cells are counted.
        cells: over the width or height, at most ``2 ** bits``; may be fractional; 0 = ``2 ** bits``.
        mean, amplitude: light, 255 = full.
        channels: the lit ones of red, green, blue; the others are dark.
    """

    size: tuple[int, int]
    bit: int
    bits: int
    inverted: bool = False
    axis: Axis = "x"
    cells: float = 0.0
    mean: float = GRAY_MEAN
    amplitude: float = GRAY_AMPLITUDE
    channels: tuple[str, ...] = CHANNELS

    def __post_init__(self) -> None:
        # The parameters shared with a fringe are checked by it.
        fringe = Fringe(self.size, 1.0, self.axis, 0.0, self.mean, self.amplitude, self.channels)
        object.__setattr__(self, "channels", fringe.channels)
        if self.bits not in range(1, MOST_BITS + 1):
            raise PatternError(f"pattern.bits is {self.bits!r:.80}, expected 1 to {MOST_BITS}")
        if self.bit not in range(self.bits):
            raise PatternError(
                f"pattern.bit is {self.bit!r:.80}, expected 0 to {self.bits - 1}, one of the {self.bits}"
            )
        cells = float(self.cells) or 2.0**self.bits
        if not 1 <= cells <= min(2**self.bits, fringe.length):
            raise PatternError(
                f"pattern.cells is {self.cells}, expected 1 to {min(2**self.bits, fringe.length)}: "
                f"{self.bits} bits and {fringe.length} pixels hold no more"
            )
        object.__setattr__(self, "cells", cells)

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Which of the three channels are lit, (3,)."""
        return np.array([name in self.channels for name in CHANNELS])

    @property
    def ones(self) -> NDArray[np.bool_]:
        """Positions along the axis at which the bit is bright, (length,)."""
        length = self.size[0] if self.axis == "x" else self.size[1]
        cell = np.floor(self.cells * (np.arange(length) + 0.5) / length).astype(np.int64)
        ones = ((cell ^ (cell >> 1)) >> (self.bits - 1 - self.bit)) & 1 == 1
        return np.asarray(ones ^ self.inverted)

    def light(self) -> Array:
        """Ideal light of the image, (height, width, 3), 0..255."""
        return np.asarray(_spread(self._wave()[:, None] * self.lit, self.axis, self.size))

    def image(self, response: Response | None = None) -> Image:
        """The image to send, (height, width, 3) uint8, pre-distorted so that its light is :meth:`light`."""
        return _sent(self._wave(), self.lit, self.axis, self.size, response)

    def as_mapping(self) -> dict[str, Any]:
        """The JSON object of this frame."""
        out: dict[str, Any] = {"kind": "gray", "size": list(self.size), "bit": self.bit, "bits": self.bits}
        out |= {"inverted": self.inverted, "axis": self.axis, "cells": self.cells}
        return out | {"mean": self.mean, "amplitude": self.amplitude, "channels": list(self.channels)}

    def _wave(self) -> Array:
        return np.asarray(self.mean + self.amplitude * np.where(self.ones, 1.0, -1.0))


def check_size(size: tuple[int, int]) -> None:
    """PatternError unless both sides are whole numbers of pixels from 1 to 8192."""
    if len(size) != 2 or any(side not in range(1, LARGEST_SIDE + 1) for side in size):
        raise PatternError(f"pattern.size is {size!r:.80}, expected [width, height], 1 to {LARGEST_SIDE} pixels each")


def _spread(line: NDArray[Any], axis: Axis, size: tuple[int, int]) -> NDArray[Any]:
    """A line along the axis, (length, 3), repeated over the image, (height, width, 3)."""
    return np.broadcast_to(line[None] if axis == "x" else line[:, None], (*size[::-1], 3))


def _sent(wave: Array, lit: NDArray[np.bool_], axis: Axis, size: tuple[int, int], response: Response | None) -> Image:
    """The image of a line of light, (length,), in the lit channels."""
    line = np.repeat(wave[:, None], 3, axis=1)
    drive = line if response is None else response.drive(line)
    # A dark channel gets drive 0, not the largest drive that still gives no light.
    return np.ascontiguousarray(_spread(np.rint(drive * lit).astype(np.uint8), axis, size))
