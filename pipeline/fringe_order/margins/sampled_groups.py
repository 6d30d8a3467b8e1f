"""Surfaces and cells of large ones, with a sample of their lattice pixels.

Large surfaces are tested in cells, because a false surface that crosses a true one is connected with it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel

SAMPLES = 32
"""Lattice pixels of each group that are compared, about; all where it has fewer."""
CELL = 64
"""Width and height of the cells in which large surfaces are tested, pixels of the left image."""
_GOLDEN = np.uint32(2654435769)  # 2^32 over the golden ratio


class Ambiguous(NamedTuple):
    """Shares of the pixels of all surfaces: rejected ones, and those in ambiguous cells of large surfaces that stay."""

    rejected: float
    kept: float


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

    def reject(self, ambiguous: NDArray[np.bool_], most: float, valid: NDArray[np.uint8]) -> Ambiguous:
        """Reject the surfaces that are ambiguous (n,), after :meth:`sampled`; ``valid`` (H, W) is changed.

        Args:
            most: as :attr:`.order_margins.Limits.ambiguous_share`.
        """
        cells, pixels = (x[self._surfaces :].reshape(-1, self._cells) for x in (ambiguous, self._pixels))
        of_large = pixels.sum(axis=1)
        rejected = ambiguous.copy()
        rejected[self._surfaces :] = False
        in_cells = (cells * pixels).sum(axis=1)
        rejected[: self._surfaces][self._row >= 0] = in_cells / np.maximum(of_large, 1) >= most
        self._reject(rejected, valid)
        of_surfaces = self._pixels[: self._surfaces].copy()
        of_surfaces[self._row >= 0] = of_large
        kept = in_cells[~rejected[: self._surfaces][self._row >= 0]].sum()
        every = max(of_surfaces.sum(), 1)
        return Ambiguous(float(of_surfaces[rejected[: self._surfaces]].sum() / every), float(kept / every))

    def reject_each(self, rejected: NDArray[np.bool_], valid: NDArray[np.uint8]) -> None:
        """Reject groups (n,), cells of large surfaces alone; ``valid`` (H, W) is changed."""
        alone = rejected.copy()
        alone[: self._surfaces][self._row >= 0] = False
        self._reject(alone, valid)

    def _reject(self, rejected: NDArray[np.bool_], valid: NDArray[np.uint8]) -> None:
        # The loop is called without rows as well, or it would be compiled in the middle of a live run.
        rows = len(valid) if rejected.any() else 0
        _reject(rows, self._label, self._row, self._cell, self._across, self._cells, rejected, valid)


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
def _reject(i: int, label: Any, row: Any, cell: int, across: int, cells: int, rejected: Any, valid: Any) -> None:
    """Reject the pixels of a row of the image whose surface or cell is rejected; arguments as of _group_pixels."""
    first = row.shape[0] + (i // cell) * across
    for j in range(label.shape[1]):
        k = np.int64(label[i, j]) - 1
        if k >= 0 and (rejected[k] or (row[k] >= 0 and rejected[first + row[k] * cells + j // cell])):
            valid[i, j] = np.uint8(0)
