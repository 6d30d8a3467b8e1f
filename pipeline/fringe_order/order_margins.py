"""How clearly fringe orders win: what a surface would cost more with the second best orders.

A surface whose orders are all wrong by the same number is as smooth as the true one. Where its texture is uniform and
the projector's phase repeats (see :func:`pipeline.filter.point_filter.phase_weight`), it costs no more either, and the
search takes one of them by chance. Such orders are found by their margin: the mean cost of a surface's lattice pixels
with all orders changed alike, less that with their own. Large surfaces are tested in cells, because a false surface
that crosses a true one is connected with it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import TILE

from pipeline.fringe_order.order_candidates import (  # isort: skip
    COST, COST_IMPOSSIBLE, INTEGER_SLOTS, SLOTS, candidate_costs, load_nodes,
)  # fmt: skip

SAMPLES = 32
"""Lattice pixels of each group that are compared, about; all where it has fewer."""
CELL = 64
"""Width and height of the cells in which large surfaces are tested, pixels of the left image."""
LEAST_SHARE = 0.5
"""Share of a group's pixels that must have an order for it to compete."""
LARGEST_COST = 0.3
"""Mean cost up to which another order explains a group; saturated surfaces cost as much with their own as with any.
Where no other projector offset is possible, pixels that cost more with their own order, mostly those at a border, are
no evidence."""
TEXTURE = 0.9
"""Share of the texture's weight in the margins: with all of it surfaces whose texture is that of the wrong place keep
their orders."""
EVEN = 0.002
"""Difference of costs up to which two orders explain a pixel alike, where the fringes repeat."""
AMBIGUOUS_SHARE = 0.35
"""Share of its pixels in ambiguous cells from which a large surface is rejected; its other cells decide fewer."""
CLEAR_GAIN, CLEAR_SHARE = 0.03, 0.5
"""The same where pixels agree with the projector's offset up to noise and the fringes do not repeat: gain in log
likelihood from which they do, see :class:`pipeline.reconstruct.column_correction.OffsetLikelihood`."""
VAGUE_GAIN, VAGUE_SHARE = 0.01, 0.25
"""The same where hardly any does, and another offset explains the pair as well: all of a wall may have wrong orders."""
_GOLDEN = np.uint32(2654435769)  # 2^32 over the golden ratio


class Limits(NamedTuple):
    """When orders win clearly.

    Args:
        margin: the least one, 0 = no test; shifts: (n,) changes of the column correction that other orders may have.
        even: difference of costs up to which two orders explain a pixel alike; surfaces have no margin where the same
            other order does so at more than half of their pixels. Negative: no such test.
        gain: in log likelihood per pixel, of the column correction.
    """

    margin: float
    shifts: NDArray[np.float64]
    even: float = -1.0
    gain: float = 0.0

    @property
    def largest_own(self) -> float:
        """Cost of a pixel's own order up to which the pixel counts."""
        return np.inf if len(self.shifts) else LARGEST_COST

    @property
    def ambiguous_share(self) -> float:
        """Share of its pixels in ambiguous cells from which a large surface is rejected."""
        if self.gain >= CLEAR_GAIN and self.even < 0:
            return CLEAR_SHARE
        return VAGUE_SHARE if len(self.shifts) and self.gain < VAGUE_GAIN else AMBIGUOUS_SHARE


class Groups:
    """The surfaces of an image, large ones divided into cells: first a group for each, then one for each cell.

    Args:
        label: (H, W) uint16, one more than the surface of each pixel, 0 = none; sizes: (surfaces,) their pixels.
        cell: width and height of the cells, pixels.
    """

    def __init__(self, label: NDArray[np.uint16], sizes: NDArray[np.int32], cell: int) -> None:
        self._label, self._surfaces, self._cell = label, len(sizes), cell
        large = sizes > cell * cell
        self._row = np.where(large, np.cumsum(large) - 1, -1).astype(np.int32)
        self._across = -(-label.shape[1] // cell)
        self._cells = self._across * -(-label.shape[0] // cell)
        self._pixels = np.zeros(self._surfaces + int(large.sum()) * self._cells, np.int32)

    def __len__(self) -> int:
        return len(self._pixels)

    def sampled(self, rows: NDArray[np.int32], columns: NDArray[np.int32]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Numbers of lattice pixels, up to about :data:`SAMPLES` of each group, and their groups.

        Args:
            rows, columns: (h,), (w,) of the lattice pixels in ``label``; -1 where they are not in it.
        """
        groups = np.empty((len(rows), len(columns)), np.int32)
        group, nodes = groups.reshape(-1), np.empty(groups.size, np.int32)
        _group_pixels(
            len(rows), self._label, self._row, rows, columns, columns // self._cell, self._cell, self._across,
            self._cells, groups,
        )  # fmt: skip
        n = _choose(group, SAMPLES, self._pixels, np.empty(len(self), np.int32), nodes)
        return nodes[:n], group[nodes[:n]]

    def reject(self, ambiguous: NDArray[np.bool_], most: float, valid: NDArray[np.uint8]) -> None:
        """Reject the surfaces that are ambiguous (n,), after :meth:`sampled`; ``valid`` (H, W) is changed.

        Args:
            most: as :attr:`Limits.ambiguous_share`.
        """
        cells, pixels = (x[self._surfaces :].reshape(-1, self._cells) for x in (ambiguous, self._pixels))
        share = (cells * pixels).sum(axis=1) / np.maximum(pixels.sum(axis=1), 1)
        rejected = ambiguous[: self._surfaces].copy()
        rejected[self._row >= 0] = share >= most
        # The loop is called without rows as well, or it would be compiled in the middle of a live run.
        _reject(len(valid) if rejected.any() else 0, self._label, rejected, valid)


@parallel
def _group_pixels(
    a: int, label: Any, row: Any, rows: Any, columns: Any, column_cells: Any, cell: int, across: int, cells: int,
    out: Any,
) -> None:  # fmt: skip
    """Group of each pixel of a lattice row, ``out`` (h, w) int32, -1 without one.

    Args:
        row: (surfaces,) numbers of the large ones, -1 = not large; rows, columns: as of :meth:`Groups.sampled`.
        column_cells: (w,) cells of the columns; across, cells: in a row of cells, in the image.
    """
    i = rows[a]
    if i < 0:
        out[a, :] = -1
        return
    first = row.shape[0] + (i // cell) * across
    for b in range(columns.shape[0]):
        j = columns[b]
        k = np.int64(label[i, j]) - 1 if j >= 0 else -1
        large = k >= 0 and row[k] >= 0
        out[a, b] = first + row[k] * cells + column_cells[b] if large else k


@serial
def _choose(group: Any, most: int, count: Any, left: Any, out: Any) -> int:
    """About ``most`` pixels of each group into ``out``; their number. ``count`` (groups,) zeros; ``left``: scratch.

    Their distances are pseudo-random: every n-th pixel of a surface whose rows have n would be one column of it.
    """
    for b in range(group.shape[0]):
        if group[b] >= 0:
            count[group[b]] += 1
    left[:] = 1
    n = 0
    for b in range(group.shape[0]):
        k = group[b]
        if k >= 0:
            left[k] -= 1
            if left[k] == 0:
                out[n] = b
                n += 1
                distances = np.uint32(2 * ((count[k] + most - 1) // most) - 1)
                left[k] = 1 + np.int32((np.uint32(b) * _GOLDEN >> np.uint32(16)) % distances)
    return n


@parallel
def _reject(i: int, label: Any, rejected: Any, valid: Any) -> None:
    for j in range(label.shape[1]):
        if label[i, j] != 0 and rejected[np.int64(label[i, j]) - 1]:
            valid[i, j] = np.uint8(0)


@parallel
def costs_of_nodes(
    block: int, nodes: Any, pixels: Any, rays: Any, phase: Any, descriptors: Any, other_descriptors: Any, columns: Any,
    linear: bool, correction: Any, extent: Any, labels: int, axis: int, inv: Any, texture: Any, first: Any, count: Any,
    costs: Any,
) -> None:  # fmt: skip
    """Costs of all candidates of a block of TILE lattice pixels; arguments as of the search's ``search_rows``.

    Args:
        nodes, pixels: (n,) numbers of the lattice pixels in the lattice and in the image.
        first, count: (h w,) int32, written at these; costs: (n, labels) float32, written.
    """
    height, width = other_descriptors.shape
    t, k = np.zeros(SLOTS * TILE, np.float32), np.zeros(INTEGER_SLOTS * TILE, np.int32)
    start = block * TILE
    n = min(TILE, nodes.shape[0] - start)
    part = nodes[start : start + n]
    most = load_nodes(t, k, part, pixels[start : start + n], n, rays.reshape(-1), phase.reshape(-1),
                      descriptors.reshape(-1), first, count, labels)  # fmt: skip
    other = other_descriptors.reshape(-1)
    costs[start : start + n] = COST_IMPOSSIBLE
    for order in range(most):
        candidate_costs(t, k, order, columns, linear, correction, extent, other, width, height, axis, inv, texture)
        for j in range(n):
            if order < count[part[j]]:
                costs[start + j, order] = t[COST + j]


@serial
def least_margins(
    group: Any, own: Any, first: Any, count: Any, costs: Any, least_share: Any, largest_cost: Any, largest_own: Any,
    even: Any, out: Any,
) -> None:  # fmt: skip
    """Least margin of each group plus its standard error, (groups,) float32; infinite where no other order competes.

    Args:
        group: (n,) of the sampled pixels; own: their orders, int16; first, count: (n,) of their candidates.
        costs: (n, labels).
        least_share: of a group's pixels that must have an order for it to compete.
        largest_cost: its largest mean cost; largest_own: as :attr:`Limits.largest_own`.
        even: as of :class:`Limits`.
    """
    labels = costs.shape[1]
    total, squares = np.zeros((out.shape[0], 2 * labels)), np.zeros((out.shape[0], 2 * labels))
    level = np.zeros((out.shape[0], 2 * labels))
    pixels, alike = np.zeros((out.shape[0], 2 * labels), np.int32), np.zeros((out.shape[0], 2 * labels), np.int32)
    for m in range(group.shape[0]):
        k, here = group[m], own[m] - first[m]
        if here < 0 or here >= count[m] or costs[m, here] > largest_own:
            continue
        for order in range(count[m]):
            change = order - here + labels
            more = np.float64(costs[m, order] - costs[m, here])
            total[k, change] += more
            squares[k, change] += more * more
            level[k, change] += costs[m, order]
            pixels[k, change] += 1
            alike[k, change] += more <= even and even >= 0
    for k in range(out.shape[0]):
        out[k] = np.inf
        for change in range(2 * labels):
            n = pixels[k, change]
            if change == labels or n < 2 or n < least_share * pixels[k, labels]:
                continue
            if 2 * alike[k, change] > n:
                out[k] = min(out[k], np.float32(0.0))
            if level[k, change] <= largest_cost * n:
                mean = total[k, change] / n
                error = np.sqrt(max(squares[k, change] / n - mean * mean, 0.0) / (n - 1))
                out[k] = min(out[k], np.float32(mean + error))
