"""Temporal fusion: the clouds of a surface at rest are averaged, pixel by pixel; what moves shows the newest cloud.

A pixel is at rest while its new depth agrees with the average, and while that holds around it, too: tiles of 16 x 16
pixels compare the mean difference and the mean squared difference with what noise explains, and a tile that moves takes
the eight around it along. The middle of a moving sphere, whose depth hardly changes, moves with its surroundings.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked, serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import root

TILE = 16
"""Rows and columns of a tile, pixels."""
_PIXEL = np.float32(16)
"""Squared difference of a pixel, in variances, up to which it is at rest."""
_MEAN, _MEAN_SQUARE = np.float32(0.8), np.float32(2.2)
"""Mean difference of a tile in standard deviations, and mean squared difference in variances, that noise does not
reach: neighbouring pixels' noise is correlated, a tile has about thirty independent ones."""
_LOST, _FLICKER = np.float32(4), np.float32(24)
"""A tile moves where more than one in so many of its pixels were known in only one of both clouds, and more than so
many: at the border of a surface at rest some come and go."""
COLUMNS = 16 * TILE
"""Pixels of a row that are averaged in one go."""
_ONE, _ZERO = np.float32(1), np.float32(0)
_YES, _NO = np.uint8(1), np.uint8(0)
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)


@serial
def _compare(xyz: Any, sigma: Any, depth: Any, variance: Any, at: Any, count: int, s: Any) -> None:
    """Add the differences of some pixels of a row to the sums of their columns.

    Args:
        xyz, sigma, depth, variance: flat; at: number of the first pixel, uint64; count: of pixels, up to COLUMNS.
        s: (5 COLUMNS,) float32, sums of deviations, of their squares, of pixels known in both clouds and in one, and
            of those whose squares were cut off.
    """
    for j in range(count):
        k = at + np.uint64(j)
        x, y, z = xyz[_3 * k], xyz[_3 * k + _1], xyz[_3 * k + _2]
        before, noise = depth[k], sigma[k] * sigma[k] + variance[k]
        known, old = z == z, before == before
        off = z - before
        square = off * off * (x * x + y * y + z * z) / (z * z * noise)
        s[4 * COLUMNS + j] += _ONE if (known & old) & (square >= _PIXEL) else _ZERO
        # A pixel at the border of something that moves must not decide alone.
        square = square if square < _PIXEL else _PIXEL
        square = square if known & old else _ZERO
        step = root(square)
        s[j] += step if off > _ZERO else -step
        s[COLUMNS + j] += square
        s[2 * COLUMNS + j] += _ONE if known & old else _ZERO
        s[3 * COLUMNS + j] += _ONE if known != old else _ZERO


@parallel_allocating
def find_motion(band: int, xyz: Any, sigma: Any, depth: Any, variance: Any, moving: Any, rest: Any) -> None:
    """Mark the tiles of a row of tiles in which the new cloud contradicts the average, and add up the others.

    Args:
        xyz: (3 H W,), sigma: (H, W), float32, of the new cloud.
        depth, variance: (H W,) float32, of the average: z in mm, variance in mm^2 along the ray; NaN = unknown.
        moving: (tiles down, tiles across) uint8, written.
        rest: (tiles down, 2) float64, written: sum of the squared differences at rest, in variances, and their number.
    """
    height, width = sigma.shape
    flat = sigma.reshape(height * width)
    s = np.empty(5 * COLUMNS, np.float32)
    rest[band] = 0
    for left in range(0, width, COLUMNS):
        s[:] = _ZERO
        count = min(COLUMNS, width - left)
        for i in range(TILE * band, min(TILE * band + TILE, height)):
            _compare(xyz, flat, depth, variance, np.uint64(i * width + left), count, s)
        for tile in range(left // TILE, (left + count + TILE - 1) // TILE):
            first = TILE * tile - left
            last = min(first + TILE, count)
            moving[band, tile] = _moves(s, first, last)
            if moving[band, tile] == _NO:
                cut = s[4 * COLUMNS + first : 4 * COLUMNS + last].sum()
                rest[band, 0] += s[COLUMNS + first : COLUMNS + last].sum() - _PIXEL * cut
                rest[band, 1] += s[2 * COLUMNS + first : 2 * COLUMNS + last].sum() - cut


@linked
def _moves(s: Any, first: int, last: int) -> Any:
    """Whether a tile's columns ``first`` to ``last`` - 1 contradict the average, 0 or 1; see :func:`_compare`."""
    total, squares, both, one = _ZERO, _ZERO, _ZERO, _ZERO
    for j in range(first, last):
        total += s[j]
        squares += s[COLUMNS + j]
        both += s[2 * COLUMNS + j]
        one += s[3 * COLUMNS + j]
    n = max(both, _ONE)
    # Fewer pixels scatter more.
    slack = _ONE + np.float32(32) / n
    changed = (abs(total) > _MEAN * slack * n) | (squares > _MEAN_SQUARE * slack * n)
    return np.uint8(changed | ((_LOST * one > both + one) & (one > _FLICKER)))


@serial
def _average(
    xyz: Any, sigma: Any, depth: Any, variance: Any, still: Any, least: Any, noisy: Any, at: Any, first: Any,
    count: int, s: Any,
) -> None:  # fmt: skip
    """New depth, variance, sigma, and scale of the position of some pixels of a row, (4 COLUMNS,) into ``s``.

    Args:
        xyz, sigma, depth, variance: flat; still: (W,) uint8, 1 where no tile around moves.
        least: weight of the newest cloud, at least; noisy: share of the variance that clouds average.
        at: number of the first pixel, uint64; first: its column, uint64.
        count: number of pixels, up to COLUMNS.
    """
    for j in range(count):
        k = at + np.uint64(j)
        x, y, z = xyz[_3 * k], xyz[_3 * k + _1], xyz[_3 * k + _2]
        before, old, noise = depth[k], variance[k], sigma[k] * sigma[k]
        off = z - before
        rest = (off * off * (x * x + y * y + z * z) <= _PIXEL * (noise + old) * z * z) & (
            still[first + np.uint64(j)] != _NO
        )
        share = old / (old + noise)
        share = share if share > least else least
        fused, other = before + share * off, _ONE - share
        averaged = other * other * old + share * share * noise
        s[j], s[COLUMNS + j] = fused if rest else z, averaged if rest else noise
        left = noise + noisy * (averaged - noise)
        s[2 * COLUMNS + j], s[3 * COLUMNS + j] = root(left) if rest else sigma[k], fused / z if rest else _ONE


@serial
def _write(s: Any, at: Any, count: int, xyz: Any, sigma: Any, depth: Any, variance: Any) -> None:
    """Write the results of :func:`_average`; loops with one array each need few tests of overlap."""
    for j in range(count):
        k = at + np.uint64(j)
        depth[k] = s[j]
    for j in range(count):
        k = at + np.uint64(j)
        variance[k] = s[COLUMNS + j]
    for j in range(count):
        k = at + np.uint64(j)
        sigma[k] = s[2 * COLUMNS + j]
    for j in range(count):
        k = _3 * (at + np.uint64(j))
        xyz[k], xyz[k + _1], xyz[k + _2] = xyz[k] * s[3 * COLUMNS + j], xyz[k + _1] * s[3 * COLUMNS + j], s[j]


@parallel_allocating
def fuse(band: int, most: int, noisy: Any, moving: Any, xyz: Any, sigma: Any, depth: Any, variance: Any) -> None:
    """Average a row of tiles where it is at rest; elsewhere the average restarts from the new cloud.

    Args:
        most: clouds that are averaged; the newest one has at least the weight 1 / most.
        noisy: float32, share of the variance in which clouds at rest differ; averages keep the rest of it.
        moving: of :func:`find_motion`; xyz: (3 H W,), sigma: (H, W), float32, changed.
        depth, variance: (H W,), of the average, changed.
    """
    down, across = moving.shape
    height, width = sigma.shape
    flat, still, s = sigma.reshape(height * width), np.empty(TILE * across, np.uint8), np.empty(4 * COLUMNS, np.float32)
    for tile in range(across):
        around = moving[max(0, band - 1) : min(down, band + 2), max(0, tile - 1) : min(across, tile + 2)]
        still[TILE * tile : TILE * tile + TILE] = _NO if around.any() else _YES
    least = _ONE / np.float32(most)
    for i in range(TILE * band, min(TILE * band + TILE, height)):
        for left in range(0, width, COLUMNS):
            at, count = np.uint64(i * width + left), min(COLUMNS, width - left)
            _average(xyz, flat, depth, variance, still, least, noisy, at, np.uint64(left), count, s)
            _write(s, at, count, xyz, flat, depth, variance)
