"""Noise of a picture, estimated from the picture itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.kernels import parallel, prange, serial

_TILE = 16
_BANDS_APART = 3
_QUANTISATION = 1 / 12
F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Variance of a sample, counts^2: ``floor + gain * counts`` (read and quantisation noise, shot noise)."""

    floor: float
    gain: float


def estimate(picture: NDArray[np.uint8], *, along: int, step: int) -> NoiseModel:
    """Fit the noise model to second differences of samples along the fringes.

    The quietest fifth of the 16-pixel tiles at each brightness is taken as free of texture: the mean square of
    ``I[-1] - 2 I[0] + I[1]`` of white noise is six times its variance. Linear in brightness, so a tile's mean serves.

    Args:
        picture: (H, W) or (H, W, 3) raw samples.
        along: axis of the picture along which the fringes run (0 for vertical fringes).
        step: distance of samples of one colour, 2 on a Bayer mosaic.
    """
    height, colors = picture.shape[0], 1 if picture.ndim == 2 else 3
    rows, shift = (step, 0) if along == 0 else (0, step * colors)
    levels, squares = _tiles(picture.reshape(height, -1), colors, rows, shift)
    samples = _TILE * _TILE
    level, spread = levels.ravel() / samples, squares.ravel() / (6 * samples)
    usable = (level > 4) & (level < 235)
    if np.count_nonzero(usable) < 20:
        return NoiseModel(1.0, 0.0)
    return _line(level[usable], spread[usable])


@serial
def _add_row(first: Any, middle: Any, last: Any, levels: Any, squares: Any) -> None:
    """Add the middle samples of a row, and the squares of its second differences."""
    for j in range(levels.shape[0]):
        m = np.int32(middle[j])
        second = np.int32(np.int32(first[j]) + np.int32(last[j]) - m - m)
        levels[j] += m
        squares[j] += np.int32(second * second)


@parallel
def _tiles(picture: Any, colors: int, rows: int, shift: int) -> tuple[Any, Any]:
    """Sums over the tiles in every third band of them, in whole numbers.

    Args:
        picture: (H, W * colors) uint8, colours interleaved.
        rows, shift: distance of the samples that are subtracted, in rows and in elements of a row.

    Returns:
        sums of the samples, and of their squared second differences, (bands, tiles, colors) int32.
    """
    height = picture.shape[0] - 2 * rows
    width = picture.shape[1] - 2 * shift
    columns = width // (_TILE * colors)
    bands = max(0, (height - _TILE) // (_BANDS_APART * _TILE) + 1)
    levels, squares = np.zeros((bands, columns, colors), np.int32), np.zeros((bands, columns, colors), np.int32)
    n = columns * _TILE * colors
    for band in prange(bands):
        top = band * _BANDS_APART * _TILE
        level, square = np.zeros(n, np.int32), np.zeros(n, np.int32)
        for i in range(top, top + _TILE):
            _add_row(picture[i][:n], picture[i + rows][shift : shift + n],
                     picture[i + 2 * rows][2 * shift : 2 * shift + n], level, square)  # fmt: skip
        for j in range(n):
            tile, k = j // (_TILE * colors), j % colors
            levels[band, tile, k] += level[j]
            squares[band, tile, k] += square[j]
    return levels, squares


def _line(level: F64, spread: F64) -> NoiseModel:
    order = np.argsort(level, kind="stable")
    groups = np.array_split(order, max(2, min(12, len(order) // 30)))
    # A tile holds some 250 nearly independent differences: its lowest fifth is 8 % below the truth on average.
    points = [(level[g].mean(), _lowest_fifth(spread[g]) * 1.08) for g in groups]
    x, y = np.array(points).T
    weight = 1 / np.maximum(y, _QUANTISATION) ** 2
    total = weight.sum()
    middle, height = (weight * x).sum() / total, (weight * y).sum() / total
    spread_x = (weight * (x - middle) ** 2).sum() / total
    gain = (weight * (x - middle) * (y - height)).sum() / total / spread_x if spread_x > 25 else 0.0
    floor = height - gain * middle
    if gain < 0 or floor < _QUANTISATION:
        gain = max(0.0, (height - _QUANTISATION) / middle)
        floor = _QUANTISATION
    return NoiseModel(float(floor), float(gain))


def _lowest_fifth(values: F64) -> float:
    """The value below which a fifth lies; np.quantile takes longer than all the rest of the estimate."""
    place = 0.2 * (len(values) - 1)
    below = int(place)
    pair = np.sort(values)[below : below + 2]
    return float(pair[0] + (place - below) * (pair[-1] - pair[0]))
