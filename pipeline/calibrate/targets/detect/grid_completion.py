"""Numbered discs: the surroundings of each, and the predicted positions of missing ones."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.board.board_drawing import MARGIN
from pipeline.calibrate.targets.detect.disc_candidates import Discs

Array = NDArray[np.float64]

_NEAREST = 12
_ASIDE_PX, _ASIDE_OVER_MEDIAN = 0.25, 7.0
"""Largest distance of a mark from its prediction by the neighbours: pixels, or times the median over all marks."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Numbered discs.

    Args:
        ids: (n,) numbers of the marks, ascending.
        discs: n discs.
        dark: dark on a light ground.
    """

    ids: NDArray[np.int64]
    discs: Discs
    dark: bool


def reach_px(discs: Discs) -> Array:
    """Half the distance from each disc's edge to the nearest other disc's edge, pixels, at least 1.5."""
    n = len(discs)
    away = discs.centres[None] - discs.centres[:, None]
    distance = np.linalg.norm(away, axis=2)
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1)[:, : min(4, n - 1)]
    row = np.arange(n)[:, None]
    apart = distance[row, near]
    direction = away[row, near] / apart[..., None]
    inverse = np.linalg.inv(discs.shapes)
    own = 1 / np.linalg.norm(np.einsum("nij,nkj->nki", inverse, direction), axis=2)
    others = 1 / np.linalg.norm(np.einsum("nkij,nkj->nki", inverse[near], direction), axis=2)
    return np.asarray(np.maximum(0.5 * (apart - own - others).min(axis=1) + 0.5, 1.5))


def clearance_px(grid: Grid, board: Board) -> Array:
    """Pixels from the outermost circles' edges to the end of a sheet with a narrow margin; infinite inside."""
    columns, rows = board.grid
    row, column = np.divmod(grid.ids, columns)
    ring = 2 if board.kind == "acircles" else 1
    outer = (row < ring) | (row >= rows - ring) | (column == 0) | (column == columns - 1)
    distance = np.linalg.norm(grid.discs.centres[None] - grid.discs.centres[:, None], axis=2)
    np.fill_diagonal(distance, np.inf)
    pitch = distance.min(axis=1) * (np.sqrt(2) if board.kind == "acircles" else 1.0)
    return np.where(outer, MARGIN[board.kind] * pitch, np.inf)


def completed(grid: Grid, board: Board) -> Grid:
    """Add the marks that were not detected, at the positions that their neighbours predict."""
    missing = np.setdiff1d(np.arange(len(board.points)), grid.ids)
    if not len(missing):
        return grid
    at = board.points[:, :2]
    centres, shapes = [], []
    for mark in missing:
        nearest = np.argsort(np.linalg.norm(at[grid.ids] - at[mark], axis=1), kind="stable")[:_NEAREST]
        guess = predicted(at[mark], at[grid.ids[nearest]], grid.discs.centres[nearest])
        if not np.isfinite(guess).all():
            return grid
        centres.append(guess)
        shapes.append(grid.discs.shapes[nearest[:4]].mean(axis=0))
    discs = Discs(
        np.concatenate([grid.discs.centres, centres]),
        np.concatenate([grid.discs.shapes, shapes]),
        np.concatenate([grid.discs.contrast, np.full(len(missing), np.median(grid.discs.contrast))]),
    )
    ids = np.concatenate([grid.ids, missing])
    order = np.argsort(ids)
    return Grid(ids[order], discs.some(order), grid.dark)


def among_neighbours(at: Array, pixels: Array) -> NDArray[np.bool_]:
    """Whether each mark is where its neighbours predict it, (n,); the edge of a shadow can shift a disc."""
    if len(at) <= _NEAREST:
        return np.ones(len(at), dtype=bool)
    away = np.empty(len(at))
    for index in range(len(at)):
        nearest = np.argsort(np.linalg.norm(at - at[index], axis=1), kind="stable")[1 : _NEAREST + 1]
        away[index] = np.linalg.norm(predicted(at[index], at[nearest], pixels[nearest]) - pixels[index])
    return away < max(_ASIDE_PX, _ASIDE_OVER_MEDIAN * float(np.nanmedian(away)))


def predicted(position: Array, positions: Array, pixels: Array) -> Array:
    """Pixel of a position on the board, by the homography of others; NaN where that is not determined."""
    plane = np.asarray(cv2.findHomography(positions, pixels, 0)[0])
    if plane.shape != (3, 3):
        return np.full(2, np.nan)
    u, v, w = plane @ [*position, 1.0]
    return np.array([u / w, v / w])
