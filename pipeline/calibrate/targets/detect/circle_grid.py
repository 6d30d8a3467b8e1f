"""Detection of the circles of a board: candidates, their grid and numbering, and a fit of each circle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.detect import detection_errors as errors
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.calibrate.targets.detect.disc_candidates import Discs, find_discs, merged
from pipeline.calibrate.targets.detect.grid_completion import Grid, among_neighbours, clearance_px, completed, reach_px
from pipeline.calibrate.targets.detect.grid_numbering import clear, extent, match, oriented
from pipeline.calibrate.targets.detect.grid_topology import Lattice, lattices
from pipeline.calibrate.targets.localise.ellipse_fit import Fits, fit_ellipses
from pipeline.calibrate.targets.localise.gray_image import GrayImage, GrayPlane
from pipeline.calibrate.targets.marks import Marks
from pipeline.common.errors import TargetError

Array = NDArray[np.float64]

_LARGE = 1_800_000
_LEAST_SHARE = 0.75
"""Share of the marks that must be detected before the others are predicted."""
_BLURRED = 0.6
"""Largest sigma of the edges, in the least half axis of the circles' images."""
_MIN_DETECTED_SHARE = 0.1
"""Share of the marks that must have been detected for a second pass that allows for shadows."""
_OTHER_BOARD_SHARE = 0.4
"""A full smaller grid with at least this share of the marks counts as another board, not as a part of this one."""
_SAMPLE = 16
_MISFIT = 0.12
_MISFIT_OVER_MEDIAN = 8.0
_SIGMA_UNREFINED_PX = 0.2


def find_circles(image: GrayImage, board: Board, *, refine: bool = True) -> Detection:
    """The marks of a board of circles; see :func:`pipeline.calibrate.targets.find_marks.find_marks`."""
    grid = _grid(image, board)
    if not refine:
        return _unrefined(image, grid)
    grid = completed(grid, board)
    fits = _fitted(image, grid.discs, clearance=clearance_px(grid, board))
    good = fits.good & (fits.contrast > 0 if grid.dark else fits.contrast < 0)
    if good.any():
        blur = float(np.median(fits.blur_px[good]))
        limit = _BLURRED * float(np.median(np.linalg.eigvalsh(grid.discs.shapes)[:, 0]))
        if blur > limit:
            raise errors.too_blurred(blur, limit)
        good &= fits.misfit < _most_misfit(float(np.median(fits.misfit[good])))
        contrast = _relative(fits)
        good &= contrast > 0.4 * np.median(contrast[good])
        good &= _inside(fits, image)
        # A detected or predicted start is never far off: a fit that moved away has followed another edge.
        good &= np.linalg.norm(fits.centres - grid.discs.centres, axis=1) < 0.5 * grid.discs.radii
        good[good] = among_neighbours(board.points[grid.ids[good], :2], fits.centres[good])
    if good.sum() < _LEAST_SHARE * len(board.points):
        raise errors.too_few(board, int(good.sum()), image)
    marks = Marks(grid.ids, fits.centres, fits.sigma_px, fits.areas_px).some(good)
    return Detection(marks, blur, float(np.clip(np.median(contrast[good]), 0, 1)), image.saturated)


def _grid(image: GrayImage, board: Board) -> Grid:
    """Detect the grid in both polarities and, in large images, on the coarse levels first.

    Raises:
        TargetError: none of them gives a grid that can be numbered; the message is that of the best attempt.
    """
    best: tuple[int, TargetError, float] | None = None
    for dark, level, shadow in _attempts(image):
        if shadow and (best is None or best[0] < _MIN_DETECTED_SHARE * len(board.points)):
            continue
        discs = find_discs(image.values, dark=dark, first_level=level)
        if shadow:
            discs = merged(discs, find_discs(_logarithm(image.values), dark=dark, first_level=level))
            discs = Discs(discs.centres, discs.shapes, np.ones(len(discs)))
        grids = lattices(discs)
        if not grids:
            continue
        grid = _numbered(image, board, discs, grids, dark=dark)
        if isinstance(grid, Grid):
            return grid
        if best is None or len(grids[0]) > best[0]:
            best = len(grids[0]), grid, float(np.median(discs.radii[grids[0].indices]))
    sigma = errors.edge_sigma_px(image)
    if best is not None and sigma > max(errors.BLURRED_PX, _BLURRED * best[2]):
        raise errors.too_blurred(sigma, max(errors.BLURRED_PX, _BLURRED * best[2]))
    if best is None or best[0] < max(6, 0.05 * len(board.points)):
        raise errors.nothing(board, image)
    raise best[1]


def _attempts(image: GrayImage) -> Iterator[tuple[bool, int, bool]]:
    """Polarity, first level of the pyramid, and whether a sharp shadow is allowed for; the likely ones first."""
    levels = (1, 0) if image.values.size > _LARGE else (0,)
    for shadow in (False, True):
        for level in levels:
            for dark in (True, False):
                yield dark, level, shadow


def _logarithm(values: GrayPlane) -> GrayPlane:
    """Logarithm of the image, in which a disc has the same contrast in shade and in light."""
    low, high = np.quantile(values[::4, ::4], [0.001, 0.999])
    floor = low - 0.02 * (high - low)
    return np.asarray(np.log(np.maximum(values - floor, 0.005 * (high - low))), dtype=np.float32)


def _numbered(image: GrayImage, board: Board, discs: Discs, grids: list[Lattice], *, dark: bool) -> Grid | TargetError:
    lattice, total = grids[0], len(board.points)
    numbering = match(lattice.positions, board)
    if len(grids) > 1 and numbering.hits > 0.5 * total and match(grids[1].positions, board).hits > 0.5 * total:
        return errors.two_boards(board)
    if board.kind == "acircles" and len(lattice) >= 0.9 * total:
        flipped = match(lattice.positions, board, mirrored=True)
        if flipped.hits > numbering.hits and flipped.hits >= 0.95 * total:
            return errors.mirrored(board)
    columns, rows = extent(lattice.positions, board)
    other = sorted((columns, rows)) != sorted(board.grid)
    surplus = len(lattice) - numbering.hits
    if other and surplus > max(2, 0.4 * min(board.grid)):
        return errors.wrong_size(board, columns, rows)
    if numbering.hits < _LEAST_SHARE * total or not clear(numbering, board):
        full = len(lattice) >= 0.95 * columns * rows and len(lattice) >= _OTHER_BOARD_SHARE * total
        if other and full and min(columns, rows) > 2 and not _runs_out(image, discs, lattice):
            return errors.wrong_size(board, columns, rows)
        return errors.too_few(board, numbering.hits, image)
    numbered = numbering.ids >= 0
    chosen = discs.some(lattice.indices[numbered])
    ids = oriented(numbering.ids[numbered], chosen.centres, board)
    order = np.argsort(ids)
    return Grid(ids[order], chosen.some(order), dark)


def _relative(fits: Fits) -> Array:
    """Contrast relative to the light level, (n,): the same in shade and in light."""
    light = np.maximum(fits.level, fits.level - fits.contrast)
    return np.abs(fits.contrast) / np.maximum(light, 1e-12)


def _inside(fits: Fits, image: GrayImage) -> NDArray[np.bool_]:
    """Discs that the edge of the image does not cut."""
    height, width = image.values.shape
    half = np.linalg.norm(fits.shapes, axis=2) + 0.5 * fits.blur_px[:, None]
    return ((fits.centres > half) & (fits.centres < np.array([width - 1, height - 1]) - half)).all(axis=1)


def _most_misfit(median: float) -> float:
    """Limit of the residuals: in a sharpened image all discs fit badly, a covered disc fits badly alone."""
    return min(max(_MISFIT_OVER_MEDIAN * median, 0.05), max(_MISFIT, 2.5 * median))


def _runs_out(image: GrayImage, discs: Discs, lattice: Lattice) -> bool:
    centres = discs.centres[lattice.indices]
    step = np.linalg.norm(centres[:, None] - centres, axis=2)
    np.fill_diagonal(step, np.inf)
    return errors.runs_out(image, centres, float(np.median(step.min(axis=1))))


def _unrefined(image: GrayImage, grid: Grid) -> Detection:
    """Centroids of the thresholded discs, for live tracking; a few discs are fitted for the sharpness."""
    n = len(grid.ids)
    sample = np.unique(np.linspace(0, n - 1, min(n, _SAMPLE)).astype(int))
    fits = _fitted(image, grid.discs, sample)
    blur = contrast = float("nan")
    if fits.good.any():
        blur = float(np.median(fits.blur_px[fits.good]))
        contrast = float(np.clip(np.median(_relative(fits)[fits.good]), 0, 1))
    areas = np.pi * grid.discs.radii**2
    marks = Marks(grid.ids, grid.discs.centres, np.full(n, _SIGMA_UNREFINED_PX), areas)
    return Detection(marks, blur, contrast, image.saturated)


def _fitted(
    image: GrayImage, discs: Discs, sample: NDArray[np.int64] | None = None, *, clearance: Array | None = None
) -> Fits:
    reach = reach_px(discs)
    if sample is not None:
        discs, reach = discs.some(sample), reach[sample]
    return fit_ellipses(image.values, discs.centres, discs.shapes, reach=reach, clearance=clearance, clip=image.clip)
