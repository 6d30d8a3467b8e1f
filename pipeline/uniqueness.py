"""One pixel of another device sees (or lights) one surface only: of two that claim it one is forgotten there.

Areas seen by the left camera alone can match areas seen by the right alone with perfect phase; nothing else removes
them. Most of the other device's picture is claimed by one surface only, which blocks of 8 x 8 pixels tell quickly;
claims to single pixels are compared in the few blocks that several surfaces claim.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import rivals
from pipeline.kernels import parallel, prange, serial

PARTS = 8
"""Bands of rows that are worked on independently: fixed, so that nothing depends on the number of threads."""

NOBODY, SEVERAL = np.int32(-1), np.int32(-2)

_HALF, _ZERO = np.float32(0.5), np.float32(0.0)
_YES, _NO = np.uint8(1), np.uint8(0)


@serial
def _blocks_of(known: Any, u: Any, v: Any, width: Any, height: Any, across: int, out: Any) -> None:
    """Block of the other device that each pixel of a row claims, -1 outside or where nothing is known."""
    columns = np.int32(across)
    for j in range(out.shape[0]):
        x, y = u[j] + _HALF, v[j] + _HALF
        inside = (x >= _ZERO) & (y >= _ZERO) & (x < width) & (y < height) & (known[j] != 0)
        x, y = x if inside else _HALF, y if inside else _HALF
        block = (np.int32(y) >> np.int32(3)) * columns + (np.int32(x) >> np.int32(3))
        out[j] = block if inside else NOBODY


@serial
def _changes(block: Any, label: Any, out: Any) -> None:
    """Whether block or surface differ from those of the pixel to the left."""
    n = out.shape[0] - 1
    a, b, p, q, into = block[1:], block[:n], label[1:], label[:n], out[1:]
    for j in range(n):
        into[j] = _YES if (a[j] != b[j]) | (p[j] != q[j]) else _NO
    out[0] = _YES


@parallel
def claim_blocks(
    known: Any, label: Any, u: Any, v: Any, width: int, height: int, start: Any, cell: Any, count: Any, owner: Any
) -> None:  # fmt: skip
    """Cut every row into pieces that one surface claims one block with, and note who claims which block.

    Args:
        known: (H, W) uint8; label: (H, W) int32; u, v: (H, W) pixel in the other device of this width and height.
        start, cell: (H, W + 1) int32, become the pieces' first columns and blocks (-1 none), from the left of each row.
        count: (H) int32, becomes the number of pieces; the row's end is noted as one more piece's start.
        owner: (PARTS, blocks) int32, becomes the claiming surface, NOBODY or SEVERAL, by bands of rows.
    """
    rows, columns = known.shape
    across = (width + 7) // 8
    words = (columns + 7) // 8
    for part in prange(PARTS):
        mine = owner[part]
        mine[:] = NOBODY
        block = np.empty(columns, np.int32)
        change = np.zeros(8 * words, np.uint8)
        change_words = change.view(np.uint64)
        for i in range(part * rows // PARTS, (part + 1) * rows // PARTS):
            _blocks_of(known[i], u[i], v[i], np.float32(width), np.float32(height), across, block)
            _changes(block, label[i], change[:columns])
            n = 0
            for word in range(words):
                if change_words[word] == 0:
                    continue
                for j in range(8 * word, 8 * word + 8):
                    if change[j] == 0:
                        continue
                    b = block[j]
                    start[i, n], cell[i, n] = j, b
                    n += 1
                    if b >= 0 and mine[b] != label[i, j]:
                        mine[b] = label[i, j] if mine[b] == NOBODY else SEVERAL
            start[i, n], count[i] = columns, n


@serial
def number_shared(owner: Any, number: Any) -> int:
    """Number the blocks that several surfaces claim (-1 the others); how many there are."""
    shared = 0
    for b in range(owner.shape[1]):
        who = NOBODY
        for part in range(PARTS):
            o = owner[part, b]
            if o != NOBODY and o != who:
                who = o if who == NOBODY else SEVERAL
        number[b] = shared if who == SEVERAL else -1
        shared += who == SEVERAL
    return shared


class Uniqueness:
    """Uniqueness in devices of up to some size, in arrays that every call uses again.

    Args:
        shape: (H, W) of the left camera's picture; devices: (width, height) of the other devices.
    """

    def __init__(self, shape: tuple[int, int], devices: tuple[tuple[int, int], ...]) -> None:
        height, width = shape
        blocks = max(((w + 7) // 8) * ((h + 7) // 8) for w, h in devices)
        self._start, self._cell = (np.empty((height, width + 1), np.int32) for _ in range(2))
        self._count, self._entries = np.empty(height, np.int32), np.empty(PARTS, np.int32)
        self._owner, self._number = np.empty((PARTS, blocks), np.int32), np.empty(blocks, np.int32)
        # Only as much as there are rival claims is ever touched of these.
        most = (PARTS, (height // PARTS + 1) * width)
        self._pixel, self._place, self._surface = (np.empty(most, np.int32) for _ in range(3))
        self._depth, self._value = (np.empty(most, np.float32) for _ in range(2))
        self._near, self._far = (np.empty(64 * blocks, np.int32) for _ in range(2))

    def apply(
        self, known: NDArray[np.uint8], label: NDArray[np.int32], size: NDArray[np.int32], u: Any, v: Any, depth: Any,
        device: tuple[int, int], value_of: Callable[[Any, Any, Any, Any], None], tolerance: float, sure: int,
    ) -> int:  # fmt: skip
        """Forget what does not prevail in one device; number of points forgotten.

        Args:
            known: (H, W) 0 or 1, changed in place; label: (H, W) surface of each known pixel.
            size: pixels of each surface.
            u, v: (H, W) pixel in the device; depth: (H, W) mm.
            device: (width, height) of the device.
            value_of: writes what must agree among claimants; called with lengths of the lists, flat indices of the
                pixels, their depths, and the array to fill.
            tolerance: largest difference of agreeing values; sure: size from which a surface is taken as established.
        """
        width, height = device
        blocks = ((width + 7) // 8) * ((height + 7) // 8)
        owner, number = self._owner[:, :blocks], self._number[:blocks]
        claim_blocks(known, label, u, v, width, height, self._start, self._cell, self._count, owner)
        shared = number_shared(owner, number)
        if not shared:
            return 0
        rivals.list_claims(
            label, u, v, depth, self._start, self._cell, self._count, number,
            self._entries, self._pixel, self._place, self._surface, self._depth,
        )  # fmt: skip
        value_of(self._entries, self._pixel, self._depth, self._value)
        near, far = self._near[: 64 * shared], self._far[: 64 * shared]
        rivals.nearest_and_farthest(self._entries, self._place, self._depth, near, far)
        return int(
            rivals.arbitrate(
                self._entries,
                self._pixel,
                self._place,
                self._surface,
                self._depth,
                self._value,
                near,
                far,
                size,
                np.float32(tolerance),
                sure,
                known.reshape(-1),
            )  # fmt: skip
        )
