"""The circles of a board in a picture: found, numbered, and each located by a fit."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import TargetError
from pipeline.targets import found as answers
from pipeline.targets.board import Board
from pipeline.targets.candidates import Discs, find_discs
from pipeline.targets.ellipse_fit import Fits, fit_ellipses
from pipeline.targets.found import Found
from pipeline.targets.grey import GreyPicture
from pipeline.targets.lattice import Lattice, lattices
from pipeline.targets.marks import Marks
from pipeline.targets.match import clear, extent, match, oriented

Array = NDArray[np.float64]

_LARGE = 1_800_000
_LEAST_SHARE = 0.75
"""Share of the marks that must be found before the others are looked for."""
_BLURRED = 0.45
"""Largest sigma of the edges, in the least half axis of the circles' images."""
_SAMPLE = 16
_MISFIT = 0.12
_MISFIT_OVER_MEDIAN = 8.0
_NEAREST = 12
_SIGMA_UNREFINED_PX = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Numbered discs."""

    ids: NDArray[np.int64]
    discs: Discs
    dark: bool


def find_circles(picture: GreyPicture, board: Board, *, refine: bool = True) -> Found:
    """The marks of a board of circles; see :func:`pipeline.targets.find.find_marks`."""
    grid = _grid(picture, board)
    if not refine:
        return _unrefined(picture, grid)
    grid = _completed(grid, board)
    fits = _fitted(picture, grid.discs)
    good = fits.good & (fits.contrast > 0 if grid.dark else fits.contrast < 0)
    if good.any():
        blur = float(np.median(fits.blur_px[good]))
        limit = _BLURRED * float(np.median(np.linalg.eigvalsh(grid.discs.shapes)[:, 0]))
        if blur > limit:
            raise answers.too_blurred(blur, limit)
        good &= fits.misfit < _most_misfit(float(np.median(fits.misfit[good])))
        good &= np.abs(fits.contrast) > 0.25 * np.median(np.abs(fits.contrast[good]))
        # A start that was predicted, or found, is never far wrong: what moved away is another edge.
        good &= np.linalg.norm(fits.centres - grid.discs.centres, axis=1) < 0.5 * grid.discs.radii
    if good.sum() < _LEAST_SHARE * len(board.points):
        raise answers.too_few(board, int(good.sum()), picture)
    marks = Marks(grid.ids, fits.centres, fits.sigma_px, fits.areas_px).some(good)
    contrast = np.abs(fits.contrast) / np.maximum(np.maximum(fits.level, fits.level - fits.contrast), 1e-12)
    return Found(marks, blur, float(np.clip(np.median(contrast[good]), 0, 1)), picture.saturated)


def _grid(picture: GreyPicture, board: Board) -> _Grid:
    """Try both polarities and, in large pictures, the coarse levels first; the best failure tells the reason.

    Raises:
        TargetError: none of them shows the board alone and whole enough to number its marks.
    """
    levels = (1, 0) if picture.values.size > _LARGE else (0,)
    best: tuple[int, TargetError] | None = None
    for level in levels:
        for dark in (True, False):
            discs = find_discs(picture.values, dark=dark, first_level=level)
            seen = lattices(discs)
            if not seen:
                continue
            answer = _numbered(picture, board, discs, seen, dark=dark)
            if isinstance(answer, _Grid):
                return answer
            if best is None or len(seen[0]) > best[0]:
                best = len(seen[0]), answer
    if best is None or best[0] < max(6, 0.05 * len(board.points)):
        raise answers.nothing(board, picture)
    raise best[1]


def _numbered(
    picture: GreyPicture, board: Board, discs: Discs, seen: list[Lattice], *, dark: bool
) -> _Grid | TargetError:
    lattice, whole = seen[0], len(board.points)
    found = match(lattice.places, board)
    if len(seen) > 1 and found.hits > 0.5 * whole and match(seen[1].places, board).hits > 0.5 * whole:
        return answers.two_boards(board)
    if board.kind == "acircles" and len(lattice) >= 0.9 * whole:
        flipped = match(lattice.places, board, mirrored=True)
        if flipped.hits > found.hits and flipped.hits >= 0.95 * whole:
            return answers.mirrored(board)
    columns, rows = extent(lattice.places, board)
    other = sorted((columns, rows)) != sorted(board.grid)
    surplus = len(lattice) - found.hits
    if other and surplus > max(2, 0.4 * min(board.grid)):
        return answers.wrong_size(board, columns, rows)
    if found.hits < _LEAST_SHARE * whole or not clear(found, board):
        full = len(lattice) >= 0.95 * columns * rows
        if other and full and min(columns, rows) >= 2 and len(lattice) >= 9:
            return answers.wrong_size(board, columns, rows)
        return answers.too_few(board, found.hits, picture)
    named = found.ids >= 0
    chosen = discs.some(lattice.indices[named])
    return _Grid(oriented(found.ids[named], chosen.centres, board), chosen, dark)


def _most_misfit(median: float) -> float:
    """Limit of the residuals: pictures that a camera has sharpened fit badly everywhere, a covered disc alone does."""
    return min(max(_MISFIT_OVER_MEDIAN * median, 0.03), max(_MISFIT, 2.5 * median))


def _unrefined(picture: GreyPicture, grid: _Grid) -> Found:
    """Centroids of the thresholded discs: for following a board live; a few discs are fitted for the sharpness."""
    n = len(grid.ids)
    sample = np.unique(np.linspace(0, n - 1, min(n, _SAMPLE)).astype(int))
    fits = _fitted(picture, grid.discs, sample)
    blur = contrast = float("nan")
    if fits.good.any():
        blur = float(np.median(fits.blur_px[fits.good]))
        light = np.maximum(fits.level, fits.level - fits.contrast)
        contrast = float(np.clip(np.median((np.abs(fits.contrast) / np.maximum(light, 1e-12))[fits.good]), 0, 1))
    areas = np.pi * grid.discs.radii**2
    marks = Marks(grid.ids, grid.discs.centres, np.full(n, _SIGMA_UNREFINED_PX), areas)
    return Found(marks, blur, contrast, picture.saturated)


def _fitted(picture: GreyPicture, discs: Discs, sample: NDArray[np.int64] | None = None) -> Fits:
    reach = _reach(discs)
    if sample is not None:
        discs, reach = discs.some(sample), reach[sample]
    return fit_ellipses(picture.values, discs.centres, discs.shapes, reach=reach, clip=picture.clip)


def _reach(discs: Discs) -> Array:
    """Half of the way from each disc's edge to the nearest other disc's edge, pixels, at least 1.5."""
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


def _completed(grid: _Grid, board: Board) -> _Grid:
    """With the marks that were not found, where their neighbours predict them."""
    missing = np.setdiff1d(np.arange(len(board.points)), grid.ids)
    if not len(missing):
        return grid
    at = board.points[:, :2]
    centres, shapes = [], []
    for mark in missing:
        nearest = np.argsort(np.linalg.norm(at[grid.ids] - at[mark], axis=1), kind="stable")[:_NEAREST]
        plane = np.asarray(cv2.findHomography(at[grid.ids[nearest]], grid.discs.centres[nearest], 0)[0])
        if plane.shape != (3, 3):
            return grid
        u, v, w = plane @ [*at[mark], 1.0]
        centres.append([u / w, v / w])
        shapes.append(grid.discs.shapes[nearest[:4]].mean(axis=0))
    discs = Discs(
        np.concatenate([grid.discs.centres, centres]),
        np.concatenate([grid.discs.shapes, shapes]),
        np.concatenate([grid.discs.contrast, np.full(len(missing), np.median(grid.discs.contrast))]),
    )
    return _Grid(np.concatenate([grid.ids, missing]), discs, grid.dark)
