"""The input of the detectors: one grey float plane of a camera's image, and its saturation level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import TargetError

GrayPlane = NDArray[np.float32]

_MAX_SATURATED_SHARE = 0.002
_LEAST_SIDE, _MOST_SIDE = 16, 16384


@dataclass(frozen=True, slots=True, eq=False)
class GrayImage:
    """One grey plane.

    Args:
        values: (H, W) float32, in the units of the image.
        clip: value from which a sample is clipped; infinite where it is unknown.
        saturated: share of the samples of the whole image, all colours, that are clipped.
    """

    values: GrayPlane
    clip: float
    saturated: float


def to_gray(image: NDArray[Any], *, channel: int | None = None) -> GrayImage:
    """The grey plane of an image.

    The mean of the three colours has the least noise; a colour of which more than 0.2 % is clipped is left out as long
    as another colour is not, because one clipped colour bends the edges of the whole sum.

    Args:
        image: (H, W) or (H, W, 3), uint8, uint16 or float32. The largest value of an integer type is a clipped one;
            so is, in a uint16 image, the top of the sensor's own range (10, 12 or 14 bit) where it is reached.
        channel: take this colour alone, 0 to 2.

    Raises:
        TargetError: an image of another shape or type, or with values that are not finite; no such channel.
    """
    image = np.asarray(image)
    colour = image.ndim == 3 and image.shape[2] == 3
    if not (colour or image.ndim == 2) or not _LEAST_SIDE <= min(image.shape[:2]) <= max(image.shape) <= _MOST_SIDE:
        raise TargetError(
            f"image of shape {image.shape}: expected (H, W) or (H, W, 3) with sides from "
            f"{_LEAST_SIDE} to {_MOST_SIDE} pixels"
        )
    if image.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise TargetError(f"image of type {image.dtype}: expected uint8, uint16 or float32")
    if image.dtype.kind == "f" and not np.isfinite(image).all():
        raise TargetError("image holds values that are not finite; the marks need an image of whole counts")
    if channel is not None and not 0 <= channel <= 2:
        raise TargetError(f"channel {channel}: expected 0, 1 or 2")
    top = _top(image)
    if not colour:
        values = np.ascontiguousarray(image, dtype=np.float32)
        return GrayImage(values, top, float((image >= top).mean()))
    saturated = np.array([(image[..., k] >= top).mean() for k in range(3)])
    used = [channel] if channel is not None else [k for k in range(3) if saturated[k] <= _MAX_SATURATED_SHARE]
    if not used:
        used = [k for k in range(3) if saturated[k] <= 1.1 * saturated.min()]
    values = image[..., used[0]].astype(np.float32)
    for k in used[1:]:
        values += image[..., k]
    values /= len(used)
    return GrayImage(values, top, float(saturated.mean()))


def image_noise(values: GrayPlane) -> float:
    """Standard deviation of the noise from second differences along the rows; edges are outvoted by the median."""
    step = max(1, values.shape[0] // 128)
    rows = values[::step]
    second = np.abs(rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2])
    return float(np.median(second)) / 0.6745 / np.sqrt(6.0)


def _top(image: NDArray[Any]) -> float:
    if image.dtype == np.uint8:
        return 255.0
    if image.dtype == np.uint16:
        largest = int(image.max())
        return float(largest) if largest in (1023, 4095, 16383, 4092, 16380, 65520, 65472, 65532) else 65535.0
    return float("inf")
