"""Lateral chromatic aberration of a camera's lens, and registration of a projector's colours, against green.

A lens magnifies every colour a little differently, and its centring shifts them: the image of a point in red light
lies at ``x + d_red(x)`` when its image in green light lies at x. The displacement is modelled as a shift, a radial
magnification and its cubic term, about the principal point, in pixels; a projector's as an affine map. Both are tiny
(tenths of a pixel) but shift the phase of each channel's fringe, see :mod:`pipeline.decode.chromatic_phase`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]

LARGEST_SHIFT_PX = 8.0
LARGEST_STRETCH = 0.02
LARGEST_CUBIC = 1.0
_COLORS = ("red", "blue")


@dataclass(frozen=True, slots=True, eq=False)
class ColorDisplacement:
    """Displacement of one colour against green in a camera's image: ``shift + (magnification + cubic r^2)(x - c)``.

    c is the principal point and r the distorted normalised radius, ``|((u - cx) / fx, (v - cy) / fy)|``.

    Args:
        shift: (2,), pixels.
        magnification: relative; red smaller than green is negative.
        cubic: its change with r^2.
    """

    shift: Array = field(default_factory=lambda: np.zeros(2))
    magnification: float = 0.0
    cubic: float = 0.0

    def at(self, camera: CameraModel, pixels: Array) -> Array:
        """Displacement at pixels of a camera, (..., 2) -> (..., 2)."""
        m = camera.matrix
        offset = pixels - np.array([m[0, 2], m[1, 2]])
        r2 = (offset[..., 0] / m[0, 0]) ** 2 + (offset[..., 1] / m[1, 1]) ** 2
        return np.asarray(self.shift + (self.magnification + self.cubic * r2)[..., None] * offset)


@dataclass(frozen=True, slots=True, eq=False)
class LateralChromatic:
    """Lateral chromatic aberration of a camera: displacement of red and blue against green."""

    red: ColorDisplacement = field(default_factory=ColorDisplacement)
    blue: ColorDisplacement = field(default_factory=ColorDisplacement)

    def at(self, camera: CameraModel, pixels: Array) -> Array:
        """Displacements of red, green and blue, (..., 2) -> (3, ..., 2), pixels."""
        pixels = np.asarray(pixels, np.float64)
        return np.stack([self.red.at(camera, pixels), np.zeros_like(pixels), self.blue.at(camera, pixels)])

    def as_mapping(self) -> dict[str, Any]:
        """The value of the key ``color.lateral`` of a calibration file."""
        return {
            name: {"shift": np.asarray(color.shift).tolist(), "magnification": color.magnification,
                   "cubic": color.cubic}
            for name, color in zip(_COLORS, (self.red, self.blue), strict=True)
        }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ColorOffset:
    """Offset of one colour against green in the projector's image: ``shift + stretch (p - centre)``.

    Its light from pixel p coincides with green light of pixel ``p + offset``.

    Args:
        shift: (2,), projector pixels, at the centre of the image.
        stretch: (2, 2).
    """

    shift: Array = field(default_factory=lambda: np.zeros(2))
    stretch: Array = field(default_factory=lambda: np.zeros((2, 2)))

    def at(self, size: tuple[int, int], pixels: Array) -> Array:
        """Offset at projector pixels, (..., 2) -> (..., 2)."""
        centre = (np.array(size, np.float64) - 1) / 2
        return np.asarray(self.shift + (pixels - centre) @ np.asarray(self.stretch).T)


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Registration of a projector's red and blue images to its green one."""

    red: ColorOffset = field(default_factory=ColorOffset)
    blue: ColorOffset = field(default_factory=ColorOffset)

    def at(self, size: tuple[int, int], pixels: Array) -> Array:
        """Offsets of red, green and blue, (..., 2) -> (3, ..., 2), projector pixels."""
        pixels = np.asarray(pixels, np.float64)
        return np.stack([self.red.at(size, pixels), np.zeros_like(pixels), self.blue.at(size, pixels)])

    def as_mapping(self) -> dict[str, Any]:
        """The value of the key ``projector.registration`` of a calibration file."""
        return {
            name: {"shift": np.asarray(color.shift).tolist(), "stretch": np.asarray(color.stretch).tolist()}
            for name, color in zip(_COLORS, (self.red, self.blue), strict=True)
        }


def lateral_chromatic_of(data: Any, name: str) -> LateralChromatic:
    """Lateral chromatic aberration of the mapping in a calibration file; ``name`` is the key, for errors."""
    colors = []
    for color in _COLORS:
        part, key = _part(data, color, name), f"{name}.{color}"
        shift = _numbers(part, "shift", key, (2,), LARGEST_SHIFT_PX, "px")
        magnification = _numbers(part, "magnification", key, (), LARGEST_STRETCH, "")
        cubic = _numbers(part, "cubic", key, (), LARGEST_CUBIC, "")
        colors.append(ColorDisplacement(shift, float(magnification), float(cubic)))
    return LateralChromatic(*colors)


def registration_of(data: Any, name: str) -> Registration:
    """Registration of the mapping in a calibration file; ``name`` is the key, for errors."""
    colors = []
    for color in _COLORS:
        part, key = _part(data, color, name), f"{name}.{color}"
        shift = _numbers(part, "shift", key, (2,), LARGEST_SHIFT_PX, "px")
        colors.append(ColorOffset(shift, _numbers(part, "stretch", key, (2, 2), LARGEST_STRETCH, "")))
    return Registration(*colors)


def _part(data: Any, color: str, name: str) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        raise CalibrationError(f"{name} is not a mapping with red and blue")
    part = data.get(color, {})
    if not isinstance(part, Mapping):
        raise CalibrationError(f"{name}.{color} is not a mapping")
    return part


def _numbers(
    data: Mapping[str, Any], key: str, name: str, shape: tuple[int, ...], limit: float, unit: str
) -> Array:  # fmt: skip
    """Numbers of a key, zero if it is absent; at most ``limit`` in size."""
    if key not in data:
        return np.zeros(shape)
    try:
        value = np.array(data[key], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{name}.{key} is not made of numbers: {data[key]!r:.80}") from error
    if value.shape != shape or not np.isfinite(value).all():
        what = " x ".join(str(n) for n in shape) or "one"
        raise CalibrationError(f"{name}.{key} must be {what} finite number{'s' * bool(shape)}, got {data[key]!r:.80}")
    if np.abs(value).max() > limit:
        raise CalibrationError(
            f"{name}.{key} is {data[key]!r:.80}, more than the limit of {limit:g} {unit}".rstrip()
            + "; repeat the colour calibration"
        )
    return value
