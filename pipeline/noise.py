"""Noise of a picture, estimated from the picture itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_TILE = 16
_BANDS_APART = 3
_QUANTISATION = 1 / 12


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
    planes = [picture] if picture.ndim == 2 else [picture[..., c] for c in range(3)]
    levels, spreads = zip(*(_tiles(np.moveaxis(p, along, 0), step) for p in planes), strict=True)
    level, spread = np.concatenate(levels), np.concatenate(spreads)
    usable = (level > 4) & (level < 235)
    if np.count_nonzero(usable) < 20:
        return NoiseModel(1.0, 0.0)
    return _line(level[usable], spread[usable])


def _tiles(plane: NDArray[np.uint8], step: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and a sixth of the mean square second difference of tiles in every third band of them."""
    height = _TILE + 2 * step
    columns = plane.shape[1] // _TILE
    levels, squares = [], []
    for top in range(0, plane.shape[0] - height + 1, _BANDS_APART * _TILE):
        x = plane[top : top + height, : columns * _TILE].astype(np.int16)
        second = x[: -2 * step] - 2 * x[step:-step] + x[2 * step :]
        squares.append((second.astype(np.float32) ** 2).reshape(_TILE, columns, _TILE).mean(axis=(0, 2)) / 6)
        levels.append(x[step:-step].reshape(_TILE, columns, _TILE).mean(axis=(0, 2)))
    if not levels:
        return np.empty(0), np.empty(0)
    return np.concatenate(levels).astype(np.float64), np.concatenate(squares).astype(np.float64)


def _line(level: NDArray[np.float64], spread: NDArray[np.float64]) -> NoiseModel:
    order = np.argsort(level, kind="stable")
    groups = np.array_split(order, max(2, min(12, len(order) // 30)))
    # A tile holds some 250 nearly independent differences: its lowest fifth is 8 % below the truth on average.
    points = [(level[g].mean(), np.quantile(spread[g], 0.2) * 1.08) for g in groups if len(g)]
    x, y = np.array(points).T
    weight = 1 / np.maximum(y, _QUANTISATION) ** 2
    middle, height = np.average(x, weights=weight), np.average(y, weights=weight)
    spread_x = np.average((x - middle) ** 2, weights=weight)
    gain = np.average((x - middle) * (y - height), weights=weight) / spread_x if spread_x > 25 else 0.0
    floor = height - gain * middle
    if gain < 0 or floor < _QUANTISATION:
        gain = max(0.0, (height - _QUANTISATION) / middle)
        floor = _QUANTISATION
    return NoiseModel(float(floor), float(gain))
