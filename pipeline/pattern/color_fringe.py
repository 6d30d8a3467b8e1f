"""The colour fringe: its projected image, and the projector column of an absolute phase.

Plain and frequency-modulated fringes share one representation: a table of the absolute phase at every column's centre.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import PatternError
from pipeline.rig.calibration import Response

Array = NDArray[np.float64]
T = TypeVar("T")

THIRD = 2 * np.pi / 3
_CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True, slots=True, eq=False)
class ColorFringe:
    """Three fringes in one image: ``mean + amplitude cos(phi(u) + shift_c)``, light 0..255.

    Args:
        size: (width, height) of the projector, pixels.
        periods: fringe periods over the width (axis x) or the height (axis y); may be fractional.
        axis: direction along which the phase grows.
        shifts: red, green, blue, radians.
        profile: absolute phase at each column's centre, strictly rising; replaces the formula (frequency modulation).
    """

    size: tuple[int, int] = (1280, 1024)
    periods: float = 96.0
    axis: Literal["x", "y"] = "x"
    mean: float = 127.5
    amplitude: float = 118.0
    shifts: tuple[float, float, float] = (-THIRD, 0.0, THIRD)
    profile: Array | None = field(default=None)

    def __post_init__(self) -> None:
        if self.axis not in ("x", "y"):
            raise PatternError(f"pattern.axis is {self.axis!r}, expected 'x' or 'y'")
        if not 0 < self.periods <= self.length / 2:
            raise PatternError(f"pattern.periods is {self.periods}, expected more than 0 and at most {self.length / 2}")
        if not (0 < self.amplitude <= self.mean and self.mean + self.amplitude <= 255.0):
            raise PatternError(
                f"pattern.mean {self.mean} and amplitude {self.amplitude} leave 0..255; lower the amplitude"
            )
        vectors = np.exp(1j * np.array(self.shifts))
        if min(abs(vectors[a] - vectors[b]) for a, b in ((0, 1), (1, 2), (2, 0))) < 0.1:
            raise PatternError(f"pattern.shifts {self.shifts} must be three different angles")
        if self.profile is not None:
            self._check_profile()

    def _check_profile(self) -> None:
        profile = np.array(self.profile, dtype=np.float64)
        if profile.shape != (self.length,):
            raise PatternError(f"pattern.profile has {profile.size} values, expected one for each of {self.length}")
        if not np.isfinite(profile).all() or (np.diff(profile) <= 0).any():
            raise PatternError("pattern.profile must be finite and strictly increasing")
        profile.setflags(write=False)
        object.__setattr__(self, "profile", profile)

    @property
    def length(self) -> int:
        """Number of projector columns (axis x) or rows (axis y)."""
        return self.size[0] if self.axis == "x" else self.size[1]

    @property
    def phase(self) -> Array:
        """Absolute phase at the centre of every column (or row), (length,), radians."""
        if self.profile is not None:
            return self.profile
        return 2 * np.pi * self.periods * (np.arange(self.length) + 0.5) / self.length

    def column_of(self, phase: Array) -> Array:
        """Projector column (or row) of absolute phases; extrapolated linearly by half a pixel beyond both ends."""
        table = self.phase
        columns = np.arange(-1.0, self.length + 1)
        ends = (2 * table[0] - table[1], 2 * table[-1] - table[-2])
        return np.interp(phase, np.concatenate([[ends[0]], table, [ends[1]]]), columns, left=np.nan, right=np.nan)

    def light(self) -> Array:
        """Ideal light of the image, (height, width, 3), 0..255."""
        waves = self.mean + self.amplitude * np.cos(self.phase[:, None] + np.array(self.shifts))
        shape = (*self.size[::-1], 3)
        return np.broadcast_to(waves[None] if self.axis == "x" else waves[:, None], shape)

    def image(self, response: Response | None = None) -> NDArray[np.uint8]:
        """The image to send, (height, width, 3) uint8, pre-distorted so that its light is :meth:`light`."""
        light = self.light()
        drive = light if response is None else response.drive(light)
        return np.rint(drive).astype(np.uint8)

    def as_mapping(self) -> dict[str, Any]:
        """The JSON object of a pattern description."""
        shifts = dict(zip(_CHANNELS, (float(s) for s in self.shifts), strict=True))
        out: dict[str, Any] = {"kind": "color_fringe", "size": list(self.size), "periods": self.periods}
        out |= {"axis": self.axis, "mean": self.mean, "amplitude": self.amplitude, "shifts": shifts}
        return out if self.profile is None else out | {"profile": self.profile.tolist()}


def from_mapping(data: Mapping[str, Any]) -> ColorFringe:
    """The pattern of a JSON object; errors name the key."""
    kind = data.get("kind")
    if kind != "color_fringe":
        raise PatternError(f"pattern.kind is {kind!r}; this program measures 'color_fringe'")
    width, height = read_field(
        data, "size", lambda value: [int(n) for n in items(value, 2)], "width and height, pixels"
    )
    shifts = read_field(
        data, "shifts", lambda value: [float(value[name]) for name in _CHANNELS], "red, green, blue (rad)"
    )
    periods, mean, amplitude = (read_field(data, key, float, "a number") for key in ("periods", "mean", "amplitude"))
    profile = None
    if data.get("profile") is not None:
        profile = read_field(
            data, "profile", lambda value: np.array(value, dtype=np.float64), "the phase of every column"
        )
    axis = data.get("axis", "x")
    return ColorFringe((width, height), periods, axis, mean, amplitude, (shifts[0], shifts[1], shifts[2]), profile)


def read_field(data: Mapping[str, Any], key: str, read: Callable[[Any], T], expected: str) -> T:
    """What ``read`` makes of a value of a pattern description; PatternError names its key."""
    if key not in data:
        raise PatternError(f"pattern.{key} is missing")
    try:
        return read(data[key])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise PatternError(f"pattern.{key} is {reprlib.repr(data[key])}, expected {expected}") from error


def items(value: Any, number: int) -> list[Any]:
    """A list of so many items, or ValueError."""
    found = list(value)
    if len(found) != number:
        raise ValueError(f"{len(found)} items")
    return found


def modulated_profile(length: int, periods: float, *, depth: float = 0.15, seed: int = 0) -> Array:
    """Phase table of a frequency-modulated fringe: period lengths T0 (1 + depth c), c smooth, aperiodic, in [-1, 1].

    For rigs whose projector is at an integer ratio of the baseline, where equal fringes do not determine the
    order on planes.
    """
    rng = np.random.default_rng(seed)
    codes = np.repeat(rng.integers(-1, 2, int(np.ceil(periods)) + 4), 8).astype(np.float64)
    smooth = np.convolve(codes, np.hanning(18)[1:-1] / np.hanning(18).sum(), mode="same")
    where = np.linspace(8, len(codes) - 9, length)
    rate = 1 / (1 + depth * np.interp(where, np.arange(len(codes)), smooth))
    edges = np.concatenate([[0.0], np.cumsum(rate)]) * (2 * np.pi * periods / rate.sum())
    return np.asarray((edges[1:] + edges[:-1]) / 2)
