"""Noise of an image, estimated from the image itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import linked
from pipeline.common.parallel_for import parallel_allocating

_TILE = 16
_SAMPLES = _TILE * _TILE
_BANDS_APART = 3
_QUANTISATION = 1 / 12


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Variance of a sample, counts^2: ``floor + gain * counts`` (read and quantisation noise, shot noise)."""

    floor: float
    gain: float


def estimate(image: NDArray[np.uint8], *, along: int, step: int, saturation: float = 254.0) -> NoiseModel:
    """Fit the noise model to second differences of samples along the fringes.

    The quietest fifth of the 16-pixel tiles at each brightness is taken as untextured: the mean square of
    ``I[-1] - 2 I[0] + I[1]`` of white noise is six times its variance. Linear in brightness, so a tile's mean serves.

    Args:
        image: (H, W) or (H, W, 3) raw samples.
        along: axis of the image along which the fringes run (0 for vertical fringes).
        step: distance of samples of one colour, 2 on a Bayer mosaic.
        saturation: counts from which a sample is saturated; a tile with one is left out, its noise is cut off.
    """
    height, colors = image.shape[0], 1 if image.ndim == 2 else 3
    rows, shift = (step, 0) if along == 0 else (0, step * colors)
    samples = image.reshape(height, -1)
    columns = (samples.shape[1] - 2 * shift) // (_TILE * colors)
    bands = max(0, (height - 2 * rows - _TILE) // (_BANDS_APART * _TILE) + 1)
    levels, squares = np.zeros((bands, columns, colors), np.int32), np.zeros((bands, columns, colors), np.int32)
    largest = np.zeros((bands, columns, colors), np.uint8)
    _tiles(bands, samples, colors, rows, shift, levels, squares, largest)
    levels, squares = levels.ravel(), squares.ravel()
    usable = (levels > 4 * _SAMPLES) & (levels < 235 * _SAMPLES) & (largest.ravel() < saturation)
    if np.count_nonzero(usable) < 20:
        return NoiseModel(1.0, 0.0)
    return _line(levels[usable], squares[usable])


@linked
def _add_row(first: Any, middle: Any, last: Any, levels: Any, squares: Any, largest: Any) -> None:
    """Add the middle samples of a row, and the squares of its second differences; update the largest samples."""
    for j in range(levels.shape[0]):
        m = np.int32(middle[j])
        second = np.int32(np.int32(first[j]) + np.int32(last[j]) - m - m)
        levels[j] += m
        squares[j] += np.int32(second * second)
    for j in range(levels.shape[0]):
        largest[j] = max(largest[j], middle[j])


@parallel_allocating
def _tiles(
    band: int, image: Any, colors: int, rows: int, shift: int, levels: Any, squares: Any, largest: Any
) -> None:  # fmt: skip
    """Sums over the tiles of one of every third bands of them, in whole numbers.

    Args:
        image: (H, W * colors) uint8, colours interleaved.
        rows, shift: distance of the samples that are subtracted, in rows and in elements of a row.
        levels, squares: (bands, tiles, colors) int32, zero before; sums of the samples, and of their squared second
            differences.
        largest: (bands, tiles, colors) uint8, zero before; the largest sample.
    """
    columns = levels.shape[1]
    n = columns * _TILE * colors
    top = band * _BANDS_APART * _TILE
    level, square, most = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n, np.uint8)
    for i in range(top, top + _TILE):
        _add_row(image[i][:n], image[i + rows][shift : shift + n],
                 image[i + 2 * rows][2 * shift : 2 * shift + n], level, square, most)  # fmt: skip
    j = 0
    for tile in range(columns):
        for _ in range(_TILE):
            for k in range(colors):
                levels[band, tile, k] += level[j]
                squares[band, tile, k] += square[j]
                largest[band, tile, k] = max(largest[band, tile, k], most[j])
                j += 1


def _points(order: NDArray[np.int64], levels: NDArray[np.int32], squares: NDArray[np.int32], groups: int) -> Any:
    """Mean brightness and variance of the quietest fifth of each group of tiles, (groups, 2).

    Args:
        order: tiles by brightness, which are split into groups as equal as possible.
        levels, squares: sums over each tile.
    """
    sizes = np.full(groups, len(order) // groups)
    sizes[: len(order) % groups] += 1
    starts = np.cumsum(sizes) - sizes
    # One row for each group, sorted at once; the shorter ones end with a number that no quantile reaches.
    rows = np.full((groups, sizes[0]), np.iinfo(np.int32).max)
    rows[np.arange(sizes[0]) < sizes[:, None]] = squares[order]
    rows.sort(axis=1)
    # As np.quantile(..., 0.2).
    position = 0.2 * (sizes - 1)
    below = position.astype(np.intp)
    low, high = rows[np.arange(groups), below], rows[np.arange(groups), below + 1]
    fifth = low + (position - below) * (high - low)
    return np.stack([np.add.reduceat(levels[order], starts) / sizes / _SAMPLES, fifth / (6 * _SAMPLES)], axis=1)


def _line(levels: NDArray[np.int32], squares: NDArray[np.int32]) -> NoiseModel:
    # Sums of 256 samples of 8 bits fit into 16 bits, for which the stable sort is a fast radix sort.
    order = np.argsort(levels.astype(np.uint16), kind="stable")
    points = _points(order, levels, squares, max(2, min(12, len(order) // 30)))
    # A tile holds some 250 nearly independent differences: its lowest fifth is 8 % too low on average.
    x, y = points[:, 0], 1.08 * points[:, 1]
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
