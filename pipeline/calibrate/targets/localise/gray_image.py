"""A camera's picture as the finders want it: one grey float plane, and which of its samples are clipped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import TargetError

Grey = NDArray[np.float32]

_MOST_CLIPPED = 0.002
_LEAST_SIDE, _MOST_SIDE = 16, 16384


@dataclass(frozen=True, slots=True, eq=False)
class GreyPicture:
    """One grey plane.

    Args:
        values: (H, W) float32, in the units of the picture.
        clip: value from which a sample is clipped; infinite where the picture does not tell.
        saturated: share of the samples of the whole picture, all colours, that are clipped.
    """

    values: Grey
    clip: float
    saturated: float


def to_grey(picture: NDArray[Any], *, channel: int | None = None) -> GreyPicture:
    """The grey plane of a picture.

    The mean of the three colours has the least noise; a colour of which more than 0.2 % is clipped is left out as long
    as another colour is not, because one clipped colour bends the edges of the whole sum.

    Args:
        picture: (H, W) or (H, W, 3), uint8, uint16 or float32. The largest value of an integer type is a clipped one;
            so is, in a uint16 picture, the top of the sensor's own range (10, 12 or 14 bit) where it is reached.
        channel: take this colour alone, 0 to 2.

    Raises:
        TargetError: a picture of another shape or type, or with values that are not finite; no such channel.
    """
    picture = np.asarray(picture)
    colour = picture.ndim == 3 and picture.shape[2] == 3
    if (
        not (colour or picture.ndim == 2)
        or not _LEAST_SIDE <= min(picture.shape[:2]) <= max(picture.shape) <= _MOST_SIDE
    ):
        raise TargetError(
            f"picture of shape {picture.shape}: expected (H, W) or (H, W, 3) with sides from "
            f"{_LEAST_SIDE} to {_MOST_SIDE} pixels"
        )
    if picture.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise TargetError(f"picture of type {picture.dtype}: expected uint8, uint16 or float32")
    if picture.dtype.kind == "f" and not np.isfinite(picture).all():
        raise TargetError("picture holds values that are not finite; the marks need a picture of whole counts")
    if channel is not None and not 0 <= channel <= 2:
        raise TargetError(f"channel {channel}: expected 0, 1 or 2")
    top = _top(picture)
    if not colour:
        values = np.ascontiguousarray(picture, dtype=np.float32)
        return GreyPicture(values, top, float((picture >= top).mean()))
    clipped = np.array([(picture[..., k] >= top).mean() for k in range(3)])
    used = [channel] if channel is not None else [k for k in range(3) if clipped[k] <= _MOST_CLIPPED]
    if not used:
        used = [k for k in range(3) if clipped[k] <= 1.1 * clipped.min()]
    values = picture[..., used[0]].astype(np.float32)
    for k in used[1:]:
        values += picture[..., k]
    values /= len(used)
    return GreyPicture(values, top, float(clipped.mean()))


def picture_noise(values: Grey) -> float:
    """Standard deviation of the noise from second differences along the rows; edges are outvoted by the median."""
    step = max(1, values.shape[0] // 128)
    rows = values[::step]
    second = np.abs(rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2])
    return float(np.median(second)) / 0.6745 / np.sqrt(6.0)


def _top(picture: NDArray[Any]) -> float:
    if picture.dtype == np.uint8:
        return 255.0
    if picture.dtype == np.uint16:
        largest = int(picture.max())
        return float(largest) if largest in (1023, 4095, 16383, 4092, 16380, 65520, 65472, 65532) else 65535.0
    return float("inf")
