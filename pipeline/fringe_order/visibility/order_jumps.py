"""Order jumps: where phase and texture continue from one segment of an image to the next, but the order changes.

At a depth edge the wrapped phase changes by any amount, and rarely by whole turns along the whole edge. Where it does,
and the texture continues too, both sides are one surface, and the order of one of them is wrong.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.common.jit import allocating, inline, serial
from pipeline.common.parallel_for import parallel
from pipeline.decode.pixel_descriptor import mean_of
from pipeline.fringe_order.left_right_check import UNDECIDED, flattened_row

SMALLEST = 9
"""Lattice pixels of the smallest segment."""
_TURN = np.float32(2 * np.pi)
_SAME_SURFACE = np.float32(1.2)
"""Change of the flattened phase between neighbouring lattice pixels of a segment, radians."""
_CONTINUES = np.float32(0.6)
"""Deviation from a whole number of turns up to which the phase continues, radians; three standard deviations of the
extrapolated phase of dark surfaces."""
_ALIKE, _COUNTS = np.float32(0.06), np.float32(2.0)
"""Difference of two means of one texture, of their sum, and counts of noise."""
_GAP, _SIDE = 3, 2
"""Lattice pixels across a border, whose own windows contain both sides, and from there to the farthest of a side."""
_OFFSET = 2**15
_NO = np.uint8(0)


class Jumps(NamedTuple):
    """Borders between segments, (n,) each: pairs of segments ``first`` < ``second`` with one change of order.

    Args:
        change: orders that the second's phase is ahead of the first's.
        continuing: places where phase and texture continue; places: all where these two segments meet.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    change: NDArray[np.int64]
    continuing: NDArray[np.int64]
    places: NDArray[np.int64]


class Segments:
    """Segments of one lattice's orders, in arrays that every pair uses again.

    After :meth:`find`: ``label`` (h, w) uint16, one more than the segment, 0 = none; ``sizes`` (segments,).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._surfaces = Surfaces(shape)
        self._flat, self._mean = np.empty(shape, np.float32), np.empty(shape, np.float32)
        self._valid, self._link, self._wide = (np.empty(shape, np.uint8) for _ in range(3))
        self._found, self._count = np.empty((2, *shape), np.int64), np.empty((2, shape[0]), np.int64)
        self.label = np.empty(shape, np.uint16)

    @property
    def sizes(self) -> NDArray[np.int32]:
        """Lattice pixels of each segment."""
        return self._surfaces.sizes

    def find(
        self, order: NDArray[np.int16], top: int, down: int, left: int, step: int, phase: NDArray[np.float32],
        descriptors: NDArray[np.int32], slopes: tuple[float, float],
    ) -> Jumps:  # fmt: skip
        """Find the segments of orders (h, w), and the jumps between them.

        Args:
            top .. step: position of the lattice in the image; phase, descriptors: (H, W) of the image.
            slopes: expected phase steps per pixel (x, y), radians.
        """
        h = len(order)
        planes = self._flat, self._mean
        load_rows(h, order, top, down, left, step, phase, descriptors, *map(np.float32, slopes), *planes, self._valid)
        link_rows(h, *planes, self._link)
        drop_narrow(h, self._link, self._wide)  # here, or it would be compiled in the middle of a live run
        return self._jumps(self._link)

    def divide(self) -> Jumps:
        """Separate what hangs together by one lattice pixel only; the jumps between all segments then."""
        return self._jumps(self._wide)

    def _jumps(self, link: NDArray[np.uint8]) -> Jumps:
        self._surfaces.find(self._valid, link, SMALLEST)
        self._surfaces.paint(self.label)
        find_jumps(len(link), self.label, self._flat, self._mean, self._found, self._count)
        found, times = np.unique(self._found.reshape(-1)[: joined(self._found, self._count)], return_counts=True)
        return _jumps_of(found, times)


@parallel
def load_rows(
    a: int, order: Any, top: int, down: int, left: int, step: int, phase: Any, descriptors: Any, slope_x: Any,
    slope_y: Any, flat: Any, mean: Any, valid: Any,
) -> None:  # fmt: skip
    """Flattened absolute phase, mean and validity (h, w) of a lattice row."""
    flattened_row(order[a], top + down * a, left, step, phase, slope_x, slope_y, flat[a])
    for b in range(order.shape[1]):
        mean[a, b] = mean_of(descriptors[top + down * a, left + step * b])
        valid[a, b] = np.uint8(order[a, b] != UNDECIDED)


@inline
def _alike(a: Any, b: Any) -> bool:
    return bool(abs(a - b) <= _ALIKE * (a + b) + _COUNTS)


@serial
def _link(flat: Any, other: Any, mean: Any, other_mean: Any, bit: Any, out: Any) -> None:
    """Add a bit to ``out`` where a row continues another one; NaN continues nothing."""
    for b in range(out.shape[0]):
        same = (abs(flat[b] - other[b]) < _SAME_SURFACE) & _alike(mean[b], other_mean[b])
        out[b] |= bit if same else _NO


@parallel
def link_rows(a: int, flat: Any, mean: Any, link: Any) -> None:
    """Links (h, w) of a lattice row, see :mod:`pipeline.common.connected_components`."""
    last = flat.shape[1] - 1
    link[a, :] = _NO
    _link(flat[a, 1:], flat[a, :last], mean[a, 1:], mean[a, :last], LEFT, link[a, 1:])
    if a > 0:
        _link(flat[a], flat[a - 1], mean[a], mean[a - 1], UP, link[a])


@parallel
def drop_narrow(a: int, link: Any, out: Any) -> None:
    """Those links (h, w) of a lattice row, ``out``, beside which one of the same direction is parallel.

    Wrong orders may meet those of a right surface in a pixel or two, mostly at the edge of a shadow.
    """
    h, w = link.shape
    # At the end of the image a link is parallel to itself.
    above, below = link[max(a - 1, 0)], link[min(a + 1, h - 1)]
    for b in range(w):
        beside = link[a, max(b - 1, 0)] | link[a, min(b + 1, w - 1)]
        out[a, b] = link[a, b] & (((above[b] | below[b]) & LEFT) | (beside & UP))


@inline
def _meet(label: Any, a: int, b: int, down: int, right: int) -> bool:
    """Whether a segment ends at (a, b), and _GAP lattice pixels further in a direction another one begins."""
    p, q = label[a, b], label[a + _GAP * down, b + _GAP * right]
    if p == q or p == 0 or q == 0:
        return False
    for k in range(1, _GAP):
        # Each border counts once: what lies between does not belong to the other side.
        c = label[a + k * down, b + k * right]
        if (2 * k <= _GAP and c == q) or (2 * k > _GAP and c == p):
            return False
    for k in range(1, _SIDE + 1):
        far = _GAP + k
        if label[a - k * down, b - k * right] != p or label[a + far * down, b + far * right] != q:
            return False
    return True


@inline
def _key(label: Any, flat: Any, mean: Any, a: int, b: int, down: int, right: int) -> Any:
    """First and second segment, change of order between them and whether phase and texture continue, as one number."""
    y, x = a + _GAP * down, b + _GAP * right
    here, there = flat[a, b], flat[y, x]
    before, after = flat[a - _SIDE * down, b - _SIDE * right], flat[y + _SIDE * down, x + _SIDE * right]
    step = np.float32(_GAP) * ((here - before) + (after - there)) / np.float32(2 * _SIDE)
    change = there - here - step
    turns = np.rint(change / _TURN)
    same = (abs(change - _TURN * turns) < _CONTINUES) & _alike(mean[a, b], mean[y, x])
    p, q, m = np.int64(label[a, b]), np.int64(label[y, x]), np.int64(turns)
    low, high, m = (p, q, m) if p < q else (q, p, -m)
    return (((low << 16) | high) << 17) | ((m + _OFFSET) << 1) | np.int64(same)


@parallel
def find_jumps(a: int, label: Any, flat: Any, mean: Any, found: Any, count: Any) -> None:
    """List the places where segments meet along a lattice row, and across it from that row on.

    Args:
        label: (h, w); flat, mean: of :func:`load_rows`.
        found: (2, h, w) int64, written: keys of :func:`_key`, those across the row second; count: (2, h) their number.
    """
    h, w = label.shape
    n = 0
    for b in range(_SIDE, w - _GAP - _SIDE):
        if _meet(label, a, b, 0, 1):
            found[0, a, n], n = _key(label, flat, mean, a, b, 0, 1), n + 1
    count[0, a], n = n, 0
    if _SIDE <= a < h - _GAP - _SIDE:
        for b in range(w):
            if _meet(label, a, b, 1, 0):
                found[1, a, n], n = _key(label, flat, mean, a, b, 1, 0), n + 1
    count[1, a] = n


@allocating
def joined(found: Any, count: Any) -> int:
    """Move what :func:`find_jumps` lists by rows to the front of ``found``; the number of all."""
    flat, n = found.reshape(-1), 0
    for k in range(count.shape[0]):
        for a in range(count.shape[1]):
            for b in range(count[k, a]):
                flat[n], n = found[k, a, b], n + 1
    return n


def _jumps_of(keys: NDArray[np.int64], times: NDArray[np.int64]) -> Jumps:
    """Jumps with a change of order of distinct keys in ascending order."""
    pair, change = keys >> 17, ((keys >> 1) & (2 * _OFFSET - 1)) - _OFFSET
    _, number = np.unique(pair, return_inverse=True)
    places = np.bincount(number, times).astype(np.int64)
    chosen = (change != 0) & (keys & 1 != 0)
    return Jumps(
        (pair >> 16)[chosen] - 1, (pair & 0xFFFF)[chosen] - 1, change[chosen], times[chosen], places[number[chosen]]
    )
