"""Connected surfaces of an image, of pixels that are linked with their left and upper neighbours.

A row's pixels that hang together are one run; runs of adjacent rows are united where at least one pixel of the one is
linked with the pixel above it. A million pixels give some thousand runs: the pixels are processed by
vector code over rows, and a union-find runs over the runs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import linked, serial
from pipeline.common.parallel_for import blocks, parallel, parallel_allocating

LEFT, UP = np.uint8(1), np.uint8(2)
"""Bits of a link: the pixel continues its left neighbour, the one above it."""

MOST_SURFACES = 65534
"""Surfaces beyond these, in scanning order, are taken as too small: an image that has them shows noise."""

_START, _CONTACT, _STOP = np.uint8(1), np.uint8(2), np.uint8(4)
_NO = np.uint8(0)
_ROWS = 32


@serial
def _joined(valid: Any, link: Any, out: Any) -> None:
    """1 where a pixel hangs together with its left neighbour; ``out`` is one longer than the row, its ends are 0."""
    n = valid.shape[0] - 1
    here, left, bits, into = valid[1:], valid[:n], link[1:], out[1:]
    for j in range(n):
        into[j] = here[j] & left[j] & bits[j]


@linked
def _touching(valid: Any, above: Any, link: Any, out: Any) -> None:
    """1 where a pixel hangs together with the one above it; ``out`` starts one pixel left of the row, with 0."""
    into = out[1:]
    for j in range(valid.shape[0]):
        into[j] = valid[j] & above[j] & (link[j] >> 1)


@serial
def _events(valid: Any, joined: Any, joined_above: Any, touching: Any, out: Any) -> None:
    """Where runs start and stop, and where two runs of adjacent rows begin to touch."""
    nxt, touch, touched = joined[1:], touching[1:], touching
    for j in range(valid.shape[0]):
        begins = valid[j] & ~joined[j]
        ends = valid[j] & ~nxt[j]
        # Where both runs go on from pixels that touched already, nothing is new.
        fresh = touch[j] & ~(touched[j] & joined[j] & joined_above[j])
        out[j] = begins | (fresh << 1) | (ends << 2)


@parallel_allocating
def find_runs(band: int, valid: Any, link: Any, start: Any, stop: Any, contact: Any, count: Any) -> None:
    """Runs of every row, and the columns in which they begin to touch runs of the row above.

    Args:
        valid: (H, W) uint8, 0 or 1; link: (H, W) uint8, bits LEFT and UP.
        start, stop, contact: (H, W or more) int32, filled from the left of each row.
        count: (2, H) int32, number of runs and of contacts of each row.
    """
    height, width = valid.shape
    blocks = (width + 7) // 8
    event = np.zeros(8 * blocks, np.uint8)
    # Most pixels are the inside of a run: eight of them are passed at once.
    event_blocks = event.view(np.uint64)
    joined = np.zeros((2, width + 1), np.uint8)
    touching = np.zeros(width + 1, np.uint8)
    top = band * _ROWS
    if top > 0:
        _joined(valid[top - 1], link[top - 1], joined[(top + 1) % 2])
    for i in range(top, min(top + _ROWS, height)):
        here, above = joined[i % 2], joined[(i + 1) % 2]
        _joined(valid[i], link[i], here)
        if i > 0:
            _touching(valid[i], valid[i - 1], link[i], touching)
        _events(valid[i], here, above, touching, event)
        runs, contacts = 0, 0
        for eight in range(blocks):
            if event_blocks[eight] == 0:
                continue
            for j in range(8 * eight, 8 * eight + 8):
                if event[j] & _START:
                    start[i, runs] = j
                if event[j] & _CONTACT:
                    contact[i, contacts] = j
                    contacts += 1
                if event[j] & _STOP:
                    stop[i, runs] = j + 1
                    runs += 1
        count[0, i], count[1, i] = runs, contacts


@serial
def _root(parent: Any, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@serial
def unite(
    start: Any, stop: Any, contact: Any, count: Any, smallest: int, first: Any, parent: Any, surface: Any, size: Any
) -> int:  # fmt: skip
    """Number of connected surfaces of at least ``smallest`` pixels, up to :data:`MOST_SURFACES`.

    Args:
        start, stop, contact, count: of :func:`find_runs`.
        first: (H + 1) int32, becomes the number of each row's first run in scanning order.
        parent: (runs) int32, scratch.
        surface: (runs) int32, becomes the run's surface (numbered in scanning order), -1 for those too small.
        size: (runs) int32, becomes each surface's pixels.
    """
    height = count.shape[1]
    first[0] = 0
    for i in range(height):
        first[i + 1] = first[i] + count[0, i]
    runs = first[height]
    for k in range(runs):
        parent[k], size[k] = k, 0
    for i in range(1, height):
        a, b = 0, 0
        for t in range(count[1, i]):
            j = contact[i, t]
            while stop[i - 1, a] <= j:
                a += 1
            while stop[i, b] <= j:
                b += 1
            p, q = _root(parent, first[i - 1] + a), _root(parent, first[i] + b)
            # The run that comes first in scanning order stays the root.
            parent[max(p, q)] = min(p, q)
    for i in range(height):
        for t in range(count[0, i]):
            k = first[i] + t
            root = _root(parent, k)
            surface[k] = root
            size[root] += stop[i, t] - start[i, t]
    surfaces = 0
    for k in range(runs):
        root = surface[k]
        if root == k:
            if size[k] >= smallest and surfaces < MOST_SURFACES:
                size[surfaces] = size[k]
                parent[k], surfaces = surfaces, surfaces + 1
            else:
                parent[k] = -1
        surface[k] = parent[root]
    return surfaces


@parallel
def paint(i: int, start: Any, stop: Any, count: Any, first: Any, surface: Any, label: Any) -> None:
    """One more than each pixel's surface into ``label`` (H, W) uint16, 0 where there is none."""
    label[i, :] = 0
    for t in range(count[0, i]):
        k = surface[first[i] + t]
        if k >= 0:
            label[i, start[i, t] : stop[i, t]] = k + 1


class Surfaces:
    """Connected surfaces of one image size, in arrays that every call uses again.

    After :meth:`find`: runs by rows in ``start``, ``stop`` and ``count`` (2, H); number of each row's first run
    in ``first`` (H + 1); surface of each run in ``surface``, -1 for too small ones; pixels of each in ``sizes``.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        height, width = shape
        # Only what an image has runs for is ever touched of these.
        # Rows a power of two apart would share few lines of a cache.
        self.start, self.stop, self.contact = (np.empty((height, width + 24), np.int32) for _ in range(3))
        self.count = np.empty((2, height), np.int32)
        self.first = np.empty(height + 1, np.int32)
        self._parent, self.surface, self._size = (np.empty(height * width, np.int32) for _ in range(3))
        self.sizes = self._size[:0]

    def find(self, valid: NDArray[np.uint8], link: NDArray[np.uint8], smallest: int) -> int:
        """Find the surfaces of at least ``smallest`` pixels; their number."""
        find_runs(blocks(len(valid), _ROWS), valid, link, self.start, self.stop, self.contact, self.count)
        number = unite(
            self.start,
            self.stop,
            self.contact,
            self.count,
            smallest,
            self.first,
            self._parent,
            self.surface,
            self._size,
        )
        self.sizes = self._size[:number]
        return int(number)

    def paint(self, label: NDArray[np.uint16]) -> None:
        """One more than each pixel's surface, 0 where there is none."""
        paint(len(label), self.start, self.stop, self.count, self.first, self.surface, label)
