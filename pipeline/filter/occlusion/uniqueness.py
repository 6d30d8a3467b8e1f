"""Uniqueness: one pixel of another device shows (or lights) one surface only; of two that claim it one is rejected.

Areas seen by the left camera alone can match areas seen by the right alone with perfect phase; nothing else removes
them. Most of the other device's image is claimed by one surface only, which blocks of 8 x 8 pixels show quickly: a
tile of the left image claims every block between its least and largest coordinates there. Claims to single pixels
are compared in the few blocks that several surfaces claim.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import linked, serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.filter.occlusion import occlusion_conflicts
from pipeline.filter.occlusion.occlusion_conflicts import TILE_COLUMNS, TILE_ROWS
from pipeline.match.match_result import OUTSIDE, PIXEL_STEPS

PARTS = 8
"""Bands of rows that are worked on independently: fixed, so that nothing depends on the number of threads."""

NOBODY, SEVERAL = np.int32(-1), np.int32(-2)

_NOWHERE, _ZERO = OUTSIDE, np.uint16(0)
BLOCK_STEPS = 8 * PIXEL_STEPS


@linked
def _masked(valid: Any, x: Any, out: Any) -> None:
    for j in range(valid.shape[0]):
        here = x[j]
        out[j] = here if valid[j] != 0 else _NOWHERE


@linked
def _least_known(x: Any, low: Any) -> None:
    for j in range(x.shape[0]):
        low[j] = x[j] if x[j] < low[j] else low[j]


@linked
def _most_known(x: Any, high: Any) -> None:
    """``high`` is one more than the coordinate, modulo 16 bits: unknown ones are 0, without a test."""
    for j in range(x.shape[0]):
        a = np.uint16(x[j] + 1)
        high[j] = a if a > high[j] else high[j]


@linked
def _least_label(label: Any, low: Any) -> None:
    """``low`` is one less than the label, modulo 16 bits: none is the largest, without a test."""
    for j in range(label.shape[0]):
        a = np.uint16(label[j] - 1)
        low[j] = a if a < low[j] else low[j]


@serial
def _least(a: Any, b: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        out[j] = a[j] if a[j] < b[j] else b[j]


@linked
def _most(a: Any, b: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        out[j] = a[j] if a[j] > b[j] else b[j]


@linked
def _least_of_16(x: Any, y: Any, n: int) -> None:
    """The least of 16 elements from each of the first n on, in place; ``y`` is scratch."""
    _least(x, x[8:], y[: n + 7])
    _least(y, y[4:], x[: n + 3])
    _least(x, x[2:], y[: n + 1])
    _least(y, y[1:], x[:n])


@linked
def _most_of_16(x: Any, y: Any, n: int) -> None:
    _most(x, x[8:], y[: n + 7])
    _most(y, y[4:], x[: n + 3])
    _most(x, x[2:], y[: n + 1])
    _most(y, y[1:], x[:n])


@linked
def _claim(owner: Any, block: int, surface: Any) -> None:
    if owner[block] != surface:
        owner[block] = surface if owner[block] == NOBODY else SEVERAL


@parallel_allocating
def claim_blocks(
    part: int, valid: Any, label: Any, u: Any, v: Any, width: int, height: int, box: Any, owner: Any
) -> None:  # fmt: skip
    """Note which surface claims which block of the other device.

    Args:
        valid: (H, W) uint8; label: (H, W) uint16, one more than the surface.
        u, v: (H, W) uint16, pixel in the other device of this width and height, see :mod:`pipeline.match.match_result`.
        box: (tiles down, tiles across, 4) int32, becomes first and last column, first and last row of the blocks that
            a tile's valid pixels lie in.
        owner: (PARTS, blocks) int32, becomes the claiming surface, `NOBODY` or `SEVERAL`, by bands of rows.
    """
    rows, columns = valid.shape
    down, tiles = box.shape[:2]
    across = (width + 7) // 8
    last_x, last_y = (width - 1) // 8, (height - 1) // 8
    n = tiles * TILE_COLUMNS
    mine = owner[part]
    mine[:] = NOBODY
    low_u, high_u, low_v, high_v, spare = (np.empty(n + 16, np.uint16), np.empty(n + 16, np.uint16),
        np.empty(n + 16, np.uint16), np.empty(n + 16, np.uint16), np.empty(n + 16, np.uint16))  # fmt: skip
    row = np.empty(columns, np.uint16)
    low, high = np.empty(n + 16, np.uint16), np.empty(n + 16, np.uint16)
    for band in range(part * down // owner.shape[0], (part + 1) * down // owner.shape[0]):
        low_u[:], high_u[:], low_v[:], high_v[:] = _NOWHERE, _ZERO, _NOWHERE, _ZERO
        low[:], high[:] = _NOWHERE, _ZERO
        top, bottom = band * TILE_ROWS, min((band + 1) * TILE_ROWS, rows)
        for i in range(top, bottom):
            _masked(valid[i], u[i], row)
            _least_known(row, low_u)
            _most_known(row, high_u)
            _masked(valid[i], v[i], row)
            _least_known(row, low_v)
            _most_known(row, high_v)
            _least_label(label[i], low)
            _most(label[i], high[:columns], high[:columns])
        _least_of_16(low_u, spare, n)
        _most_of_16(high_u, spare, n)
        _least_of_16(low_v, spare, n)
        _most_of_16(high_v, spare, n)
        _least_of_16(low, spare, n)
        _most_of_16(high, spare, n)
        for tile in range(tiles):
            j = tile * TILE_COLUMNS
            x0, x1 = low_u[j] // BLOCK_STEPS, min((high_u[j] - 1) // BLOCK_STEPS, last_x)
            y0, y1 = low_v[j] // BLOCK_STEPS, min((high_v[j] - 1) // BLOCK_STEPS, last_y)
            box[band, tile, 0], box[band, tile, 1], box[band, tile, 2], box[band, tile, 3] = x0, x1, y0, y1
            if high[j] == 0:
                box[band, tile, 1] = -1
            elif high[j] == low[j] + 1:
                for y in range(y0, y1 + 1):
                    for x in range(x0, x1 + 1):
                        _claim(mine, y * across + x, np.int32(low[j]))
            else:
                for i in range(top, bottom):
                    for m in range(j, min(j + TILE_COLUMNS, columns)):
                        x, y = u[i, m] // BLOCK_STEPS, v[i, m] // BLOCK_STEPS
                        if valid[i, m] and x <= last_x and y <= last_y:
                            _claim(mine, y * across + x, np.int32(label[i, m]) - 1)


@linked
def _join(a: Any, b: Any) -> None:
    for j in range(a.shape[0]):
        other = a[j] if b[j] == NOBODY else SEVERAL
        a[j] = b[j] if (a[j] == NOBODY) | (a[j] == b[j]) else other


@serial
def number_shared(owner: Any, number: Any) -> int:
    """Number the blocks that several surfaces claim; others get -1. ``owner`` is joined into its first part."""
    joined = owner[0]
    for part in range(1, owner.shape[0]):
        _join(joined, owner[part])
    shared = 0
    for b in range(number.shape[0]):
        number[b] = -1
        if joined[b] == SEVERAL:
            number[b], shared = shared, shared + 1
    return shared


class Uniqueness:
    """For one image size and the other devices of these sizes (width, height); arrays that every call uses again."""

    def __init__(self, shape: tuple[int, int], devices: tuple[tuple[int, int], ...]) -> None:
        height, width = shape
        blocks = max(((w + 7) // 8) * ((h + 7) // 8) for w, h in devices)
        tiles = (height + TILE_ROWS - 1) // TILE_ROWS, (width + TILE_COLUMNS - 1) // TILE_COLUMNS
        self._box = np.empty((*tiles, 4), np.int32)
        self._owner, self._number = np.empty((PARTS, blocks), np.int32), np.empty(blocks, np.int32)
        # Only the part with claims in conflict is ever touched.
        rows = -(-tiles[0] // PARTS) * TILE_ROWS
        self._claims = occlusion_conflicts.Claims.empty(PARTS, rows * width)
        self._near, self._far = (np.empty(64 * blocks, np.int32) for _ in range(2))

    def apply(
        self, valid: NDArray[np.uint8], label: NDArray[np.uint16], size: NDArray[np.int32], u: Any, v: Any, depth: Any,
        device: tuple[int, int], values: occlusion_conflicts.Values, tolerance: int, sure: int,
    ) -> None:  # fmt: skip
        """Reject the points that lose their pixel in one device.

        Args:
            valid: (H, W) 0 or 1, changed in place; label: (H, W) one more than the surface of each valid pixel.
            size: pixels of each surface.
            u, v: (H, W) uint16, pixel in the device; depth: (H, W) mm.
            device: (width, height) of the device.
            values: what must agree among claimants; tolerance: largest difference of agreeing values.
            sure: size from which a surface is taken as established.
        """
        width, height = device
        blocks = ((width + 7) // 8) * ((height + 7) // 8)
        # Contiguous for both devices, so that the kernels are compiled once.
        owner = self._owner.reshape(-1)[: PARTS * blocks].reshape(PARTS, blocks)
        number, c = self._number[:blocks], self._claims
        claim_blocks(PARTS, valid, label, u, v, width, height, self._box, owner)
        shared = number_shared(owner, number)
        if not shared:
            return
        occlusion_conflicts.list_claims(
            PARTS, valid, label, u, v, depth, values, width, height, self._box, number,
            c.entries, c.pixel, c.place, c.surface, c.depth, c.value,
        )  # fmt: skip
        near, far = self._near[: 64 * shared], self._far[: 64 * shared]
        occlusion_conflicts.nearest_and_farthest(c.entries, c.place, c.depth, near, far)
        against = np.zeros((PARTS, len(size)), np.int32)
        occlusion_conflicts.find_conflicts(
            PARTS, c.entries, c.place, c.surface, c.value, near, far, tolerance, c.conflict, against
        )
        share = (against.sum(axis=0) / size).astype(np.float32)
        occlusion_conflicts.arbitrate(
            PARTS,
            c.entries,
            c.pixel,
            c.place,
            c.surface,
            c.depth,
            c.conflict,
            near,
            far,
            size,
            share,
            sure,
            valid.reshape(-1),
        )
