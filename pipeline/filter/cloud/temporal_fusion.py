"""Temporal fusion: the clouds of a surface at rest are averaged, pixel by pixel; what moves shows the newest cloud.

A pixel is at rest while its new depth agrees with the average, and while that holds around it, too: tiles of 16 x 16
pixels compare the mean difference and the mean squared difference with what noise explains, and a tile that moves takes
the eight around it along. The middle of a moving sphere, whose depth hardly changes, moves with its surroundings.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import parallel

TILE = 16
"""Rows and columns of a tile, pixels."""
_PIXEL = np.float32(16)
"""Squared difference of a pixel, in variances, up to which it is at rest."""
_MEAN, _MEAN_SQUARE = np.float32(0.8), np.float32(2.2)
"""Mean difference of a tile in standard deviations, and mean squared difference in variances, that noise does not
reach: neighbouring pixels' noise is correlated, a tile has about thirty independent ones."""
_LOST = 4
"""A tile moves where more than one in so many of its pixels were known in only one of both clouds."""
_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel
def find_motion(band: int, xyz: Any, sigma: Any, depth: Any, variance: Any, moving: Any) -> None:
    """Mark the tiles of a row of tiles in which the new cloud contradicts the average.

    Args:
        xyz: (H, W, 3), sigma: (H, W), float32, of the new cloud.
        depth, variance: (H, W) float32, of the average: z in mm, variance in mm^2 along the ray; NaN = unknown.
        moving: (tiles down, tiles across) uint8, written.
    """
    height, width = sigma.shape
    for tile in range(moving.shape[1]):
        total, squares, both, one = _ZERO, _ZERO, 0, 0
        for i in range(TILE * band, min(TILE * band + TILE, height)):
            for j in range(TILE * tile, min(TILE * tile + TILE, width)):
                z, before = xyz[i, j, 2], depth[i, j]
                if z == z and before == before:
                    x, y = xyz[i, j, 0], xyz[i, j, 1]
                    along = (x * x + y * y + z * z) / (z * z)
                    off, noise = z - before, sigma[i, j] * sigma[i, j] + variance[i, j]
                    # A pixel at the border of something that moves must not decide alone.
                    square = min(off * off * along / noise, _PIXEL)
                    squares += square
                    total += np.sqrt(square) if off > _ZERO else -np.sqrt(square)
                    both += 1
                else:
                    one += int((z == z) != (before == before))
        n = np.float32(max(both, 1))
        # Fewer pixels scatter more.
        slack = _ONE + np.float32(32) / n
        changed = (abs(total) > _MEAN * slack * n) | (squares > _MEAN_SQUARE * slack * n)
        moving[band, tile] = np.uint8(changed | (_LOST * one > both + one))


@parallel
def fuse(i: int, most: int, moving: Any, xyz: Any, sigma: Any, depth: Any, variance: Any) -> None:
    """Average a row where it is at rest; elsewhere the average restarts from the new cloud.

    Args:
        most: clouds that are averaged; the newest one has at least the weight 1 / most.
        moving: of :func:`find_motion`; xyz: (H, W, 3), sigma: (H, W), float32, changed.
        depth, variance: of the average, changed.
    """
    down, across = moving.shape
    tile_row = i // TILE
    for j in range(sigma.shape[1]):
        x, y, z = xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2]
        before, old, new = depth[i, j], variance[i, j], sigma[i, j] * sigma[i, j]
        rest = (z == z) & (before == before)
        if rest:
            off = z - before
            rest = off * off * (x * x + y * y + z * z) <= _PIXEL * (new + old) * z * z
        if rest:
            tile = j // TILE
            for a in range(max(0, tile_row - 1), min(down, tile_row + 2)):
                for b in range(max(0, tile - 1), min(across, tile + 2)):
                    rest &= moving[a, b] == 0
        if not rest:
            depth[i, j], variance[i, j] = z, new
            continue
        share = max(old / (old + new), _ONE / np.float32(most))
        depth[i, j] = before + share * (z - before)
        variance[i, j] = (_ONE - share) * (_ONE - share) * old + share * share * new
        scale = depth[i, j] / z
        xyz[i, j, 0], xyz[i, j, 1], xyz[i, j, 2] = x * scale, y * scale, depth[i, j]
        sigma[i, j] = np.sqrt(variance[i, j])
