"""The drawing of a board: black shapes on white paper, as a list and as an image.

Both are in the board's frame (mm, origin at mark 0, see :mod:`pipeline.calibrate.targets.board.board`), which printer,
simulator and detectors share.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.board.charuco_board import charuco
from pipeline.common.errors import TargetError

Array = NDArray[np.float64]

MARGIN = {"circles": 0.375, "acircles": 0.375, "chessboard": 0.5, "charuco": 0.5}
"""White between the outermost black and the edge of the paper, in pitches. The detectors need about this much."""
_MOST_PIXELS = 1 << 27
_STRIPS = 16
"""Strips a pixel is cut into where the edge of a disc crosses it; along a strip the covered length is exact."""


@dataclass(frozen=True, slots=True, eq=False)
class Printed:
    """All black shapes on a sheet of white paper.

    Args:
        width_mm, height_mm: of the sheet.
        offset_mm: x, y of mark 0 from the sheet's top left corner; the sheet begins at ``-offset_mm``.
        discs: (n, 3) x, y, radius; mm in the board's frame.
        squares: (m, 4) x0, y0, x1, y1 with x0 < x1 and y0 < y1; none overlaps another.
    """

    width_mm: float
    height_mm: float
    offset_mm: tuple[float, float]
    discs: Array
    squares: Array


def shapes(board: Board, *, paper_mm: tuple[float, float] | None = None) -> Printed:
    """The drawing of a board as a list of shapes.

    Args:
        board: any kind.
        paper_mm: width and height of the sheet, the drawing in its middle; None = drawing and a narrow margin.

    Raises:
        TargetError: the drawing does not fit on the paper; the dictionary of markers is unknown or too small.
    """
    discs, squares = _discs(board), _squares(board)
    low = np.concatenate([discs[:, :2] - discs[:, 2:], squares[:, :2]]).min(axis=0)
    high = np.concatenate([discs[:, :2] + discs[:, 2:], squares[:, 2:]]).max(axis=0)
    margin = np.full(2, MARGIN[board.kind] * board.pitch_mm)
    if paper_mm is not None:
        margin = (np.asarray(paper_mm, dtype=np.float64) - (high - low)) / 2
        if not (margin >= 0).all():
            raise TargetError(
                f"board {board}: the drawing is {high[0] - low[0]:g} x {high[1] - low[1]:g} mm and the paper "
                f"{paper_mm[0]:g} x {paper_mm[1]:g} mm; take larger paper, a smaller pitch or fewer marks"
            )
    width, height = (high - low + 2 * margin).tolist()
    x, y = (margin - low).tolist()
    return Printed(width, height, (x, y), discs, squares)


def raster(
    board: Board, step_mm: float, *, paper_mm: tuple[float, float] | None = None
) -> tuple[NDArray[np.float32], tuple[float, float]]:
    """The sheet as an image: the share of white in every pixel.

    Args:
        board: any kind.
        step_mm: side of a pixel. The sheet is covered by whole pixels, the last ones may reach beyond it.
        paper_mm: see :func:`shapes`.

    Returns:
        (H, W) share of white, 0 = black to 1 = white, exact to about 1e-4 (edges are area averages), and the position
        (x, y) in mm of the centre of pixel (0, 0) in the board's frame; x grows with the column, y with the row.

    Raises:
        TargetError: as :func:`shapes`; or more than 134 million pixels.
    """
    printed = shapes(board, paper_mm=paper_mm)
    if not step_mm > 0 or printed.width_mm * printed.height_mm > _MOST_PIXELS * step_mm**2:
        raise TargetError(f"board {board}: an image with pixels of {step_mm:g} mm has too many; take larger pixels")
    width, height = (int(np.ceil(side / step_mm - 1e-9)) for side in (printed.width_mm, printed.height_mm))
    black = np.zeros((height, width), dtype=np.float32)
    to_edges = np.asarray(printed.offset_mm)
    for x0, y0, x1, y1 in (printed.squares + np.tile(to_edges, 2)) / step_mm:
        rows, columns = _covered(y0, y1, height), _covered(x0, x1, width)
        black[rows[0], columns[0]] += np.outer(rows[1], columns[1]).astype(np.float32)
    for x, y, radius in printed.discs:
        _add_disc(black, (x + to_edges[0]) / step_mm, (y + to_edges[1]) / step_mm, radius / step_mm)
    half = step_mm / 2
    return 1 - np.clip(black, 0, 1), (half - printed.offset_mm[0], half - printed.offset_mm[1])


def _discs(board: Board) -> Array:
    if not board.round:
        return np.empty((0, 3))
    points = board.points.copy()
    points[:, 2] = board.printed_diameter_mm / 2
    return points


def _squares(board: Board) -> Array:
    """Black squares, the one at the upper left of mark 0 among them, and the black cells of the markers."""
    if board.round:
        return np.empty((0, 4))
    columns, rows = (board.columns, board.rows) if board.kind == "charuco" else (board.columns + 1, board.rows + 1)
    row, column = np.nonzero(np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0)
    corner = np.stack([column, row], axis=1) - 1.0
    chess = np.concatenate([corner, corner + 1], axis=1) * board.pitch_mm
    return chess if board.kind == "chessboard" else np.concatenate([chess, _markers(board)])


def _markers(board: Board) -> Array:
    """Black cells of the ArUco markers, neighbours in a row joined."""
    charuco_board = charuco(board)
    markers = charuco_board.getDictionary()
    cells = int(markers.markerSize) + 2
    side = board.marker_mm / cells
    cells_of_markers = []
    for number, corners in zip(charuco_board.getIds().ravel(), charuco_board.getObjPoints(), strict=True):
        image = cv2.aruco.generateImageMarker(markers, int(number), cells)
        edges = np.diff((image == 0).astype(np.int8), axis=1, prepend=0, append=0)
        row, first = np.nonzero(edges > 0)
        last = np.nonzero(edges < 0)[1]
        origin = np.asarray(corners)[0, :2] - board.pitch_mm
        cell = np.stack([first, row, last, row + 1], axis=1) * side
        cells_of_markers.append(cell + np.tile(origin, 2))
    return np.concatenate(cells_of_markers)


def _covered(start: float, stop: float, size: int) -> tuple[slice, Array]:
    """Pixels that an interval touches (in pixels from the edge of the first), and the share of each it covers."""
    first, last = max(int(np.floor(start)), 0), min(int(np.ceil(stop)), size)
    pixel = np.arange(first, last)
    return slice(first, last), np.clip(np.minimum(stop, pixel + 1) - np.maximum(start, pixel), 0, 1)


def _add_disc(black: NDArray[np.float32], x: float, y: float, radius: float) -> None:
    """Add the share of each pixel that a disc covers; coordinates in pixels from the image's upper left edge."""
    height, width = black.shape
    left, right = max(int(np.floor(x - radius)), 0), min(int(np.ceil(x + radius)), width)
    top, bottom = max(int(np.floor(y - radius)), 0), min(int(np.ceil(y + radius)), height)
    across = left + (np.arange((right - left) * _STRIPS) + 0.5) / _STRIPS
    chord = np.sqrt(np.clip(radius**2 - (across - x) ** 2, 0, None))
    row = np.arange(top, bottom)[:, None]
    covered = np.clip(np.minimum(y + chord, row + 1) - np.maximum(y - chord, row), 0, 1)
    black[top:bottom, left:right] += (
        covered.reshape(bottom - top, right - left, _STRIPS).mean(axis=2).astype(np.float32)
    )
