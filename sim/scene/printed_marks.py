"""Marks printed on the front of a rectangle: black discs and black squares, exact to a fraction of a ray.

The fraction of ink at a ray is that of a small window on the paper as wide as the distance to the next ray, so that
areas and centroids are correct for any number of rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import unowned
from sim.scene.jit import compiled, inline

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# Wider than the softest edge, so that a cell lists all marks that reach into it.
_GUARD_MM = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Ink:
    """Black marks on the front (the side z < 0) of a rectangle, in its frame; they do not overlap.

    Args:
        discs: (n, 3) centre x, y and radius, mm.
        squares: (m, 4) x0, y0, x1, y1, mm.
        share: albedo of the ink as a share of the paper's.
    """

    discs: Array
    squares: Array
    share: float

    def __post_init__(self) -> None:
        if self.discs.ndim != 2 or self.discs.shape[1] != 3 or self.squares.ndim != 2 or self.squares.shape[1] != 4:
            raise ValueError(f"ink: discs {self.discs.shape} and squares {self.squares.shape}, expected (n, 3), (m, 4)")
        if not 0 <= self.share < 1:
            raise ValueError(f"ink: share is {self.share}, expected 0 to less than 1")

    def cells(self) -> Cells:
        """The marks sorted into cells of the paper, so that a ray is tested against few of them."""
        x, y, r = self.discs.T
        boxes = np.concatenate([np.stack([x - r, y - r, x + r, y + r], axis=1), self.squares])
        low, high = boxes[:, :2].min(axis=0) - 2 * _GUARD_MM, boxes[:, 2:].max(axis=0) + 2 * _GUARD_MM
        size = float(max(np.median(boxes[:, 2:] - boxes[:, :2]), (high - low).max() / 256))
        columns, rows = (int(n) for n in np.ceil((high - low) / size))
        members: list[list[int]] = [[] for _ in range(columns * rows)]
        for index, item in enumerate(boxes):
            j0, i0 = (int(n) for n in np.floor((item[:2] - _GUARD_MM - low) / size))
            j1, i1 = (int(n) for n in np.floor((item[2:] + _GUARD_MM - low) / size))
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    members[i * columns + j].append(index)
        first = np.concatenate([[0], np.cumsum([len(cell) for cell in members])]).astype(np.int64)
        items = np.array([index for cell in members for index in cell], np.int64)
        grid = np.array([low[0], low[1], size, columns, rows])
        return Cells(
            np.ascontiguousarray(self.discs), np.ascontiguousarray(self.squares), self.share, grid, first, items
        )


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """:class:`Ink` for compiled code: ``items[first[c] : first[c + 1]]`` reach into cell c; discs come first."""

    discs: Array
    squares: Array
    share: float
    grid: Array
    first: Ints
    items: Ints


def darken(
    light: NDArray[np.float32],
    cells: Cells,
    pose: tuple[Array, Array],
    points: Array,
    on_rectangle: NDArray[np.bool_],
    viewer: Array,
    spread: float,
) -> None:
    """Reduce the light that a rectangle reflects by what its ink absorbs, in place.

    Args:
        light: (n, 3); pose: rectangle to world.
        points: (n, 3) of the world; on_rectangle: (n,) which of them lie on the rectangle.
        viewer: (3,) origin of the rays; spread: angle between neighbouring rays, radians.
    """
    rotation, place = pose
    eye = (viewer - place) @ rotation
    if eye[2] >= 0:
        return
    _darken(
        light, points, on_rectangle, rotation, place, eye, spread, cells.share, cells.discs, cells.squares, cells.grid,
        cells.first, cells.items,
    )  # fmt: skip


@inline
def _inside(distance: float, width: float) -> float:
    """Fraction of a window that lies inside an edge at a signed distance from its middle."""
    return min(max(0.5 + distance / min(width, 2 * _GUARD_MM), 0.0), 1.0)


@inline
def _disc(disc: Array, x: float, y: float, slope_x: float, slope_y: float, width: float) -> float:
    ax, ay = x - disc[0], y - disc[1]
    away = np.sqrt(ax * ax + ay * ay)
    if away < 1e-9:
        return 1.0
    # On the paper, a step between rays is longer along the slant of the ray.
    along = (ax * slope_x + ay * slope_y) / away
    return _inside(disc[2] - away, width * np.sqrt(1 + along * along))


@inline
def _square(square: Array, x: float, y: float, wide: float, high: float) -> float:
    across = _inside(x - square[0], wide) - _inside(x - square[2], wide)
    down = _inside(y - square[1], high) - _inside(y - square[3], high)
    return max(across * down, 0.0)


@compiled
def _darken(
    light: NDArray[np.float32],
    points: Array,
    on_rectangle: NDArray[np.bool_],
    r: Array,
    place: Array,
    eye: Array,
    spread: float,
    share: float,
    discs: Array,
    squares: Array,
    grid: Array,
    first: Ints,
    items: Ints,
) -> None:
    discs, squares = unowned(discs), unowned(squares)
    columns, rows = int(grid[3]), int(grid[4])
    for k in range(len(points)):
        if not on_rectangle[k]:
            continue
        cx, cy, cz = points[k, 0] - place[0], points[k, 1] - place[1], points[k, 2] - place[2]
        x = r[0, 0] * cx + r[1, 0] * cy + r[2, 0] * cz
        y = r[0, 1] * cx + r[1, 1] * cy + r[2, 1] * cz
        j, i = int(np.floor((x - grid[0]) / grid[2])), int(np.floor((y - grid[1]) / grid[2]))
        if i < 0 or j < 0 or i >= rows or j >= columns:
            continue
        cell = i * columns + j
        if first[cell] == first[cell + 1]:
            continue
        dx, dy, dz = x - eye[0], y - eye[1], -eye[2]
        slope_x, slope_y = dx / dz, dy / dz
        width = spread * np.sqrt(dx * dx + dy * dy + dz * dz)
        wide, high = width * np.sqrt(1 + slope_x * slope_x), width * np.sqrt(1 + slope_y * slope_y)
        cover = 0.0
        for n in range(first[cell], first[cell + 1]):
            index = items[n]
            if index < len(discs):
                cover += _disc(discs[index], x, y, slope_x, slope_y, width)
            else:
                cover += _square(squares[index - len(discs)], x, y, wide, high)
        kept = np.float32(1 - min(cover, 1.0) * (1 - share))
        for c in range(3):
            light[k, c] *= kept
