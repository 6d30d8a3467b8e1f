"""Detection of the inner corners of a chessboard: found by OpenCV, then numbered, and refined by a fit."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.detect import detection_errors as errors
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.calibrate.targets.detect.grid_numbering import oriented, symmetries
from pipeline.calibrate.targets.localise.corner_fit import CornerFits, fit_crossings
from pipeline.calibrate.targets.localise.gray_image import GrayImage
from pipeline.calibrate.targets.marks import Marks

Array = NDArray[np.float64]
Eight = NDArray[np.uint8]

_REACH = 0.42
_LEAST_SHARE = 0.75
_SMOOTH_PX, _OVER_NOISE = 2.0, 3.0
_BLURRED = 0.22
"""Largest sigma of the edges as a share of the shorter side of a square."""
_MISFIT_OVER_MEDIAN = 6.0
_SIGMA_UNREFINED_PX = 0.1
_QUICK_SIDE = 1100
_THOROUGH = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


def find_chessboard(image: GrayImage, board: Board, *, refine: bool = True) -> Detection:
    """The inner corners of a chessboard; see :func:`pipeline.calibrate.targets.find_marks.find_marks`."""
    eight_bit_image = eight_bit(image)
    corners = _corners(eight_bit_image, board.grid, quick=not refine)
    if corners is None:
        raise _reason(image, eight_bit_image, board)
    at = board.points[:, :2] / board.pitch_mm
    corners = _right_handed(corners, board)
    fits = fit_crossings(image, corners, at, reach=_REACH)
    ids = oriented(np.arange(len(at)), corners, board, _by_colour(fits, board))
    side = shorter_side(corners, board)
    if not refine:
        return detection_of(image, ids, corners, np.full(len(ids), _SIGMA_UNREFINED_PX), fits)
    good = usable(fits, corners, side)
    if good.any() and float(np.median(fits.blur_px[good])) > _BLURRED * side:
        raise errors.too_blurred(float(np.median(fits.blur_px[good])), _BLURRED * side)
    if good.sum() < _LEAST_SHARE * len(at):
        raise errors.too_few(board, int(good.sum()), image)
    if _corners(_without(eight_bit_image, corners, board), board.grid, quick=True) is not None:
        raise errors.two_boards(board)
    return detection_of(image, ids[good], fits.centres[good], fits.sigma_px[good], fits)


def eight_bit(image: GrayImage) -> Eight:
    """The image stretched to 8 bit, as OpenCV's detectors expect it."""
    low, high = np.quantile(image.values[::4, ::4], [0.002, 0.998])
    stretched = (image.values - low) * (255 / max(float(high - low), 1e-12))
    return np.asarray(np.clip(np.round(stretched), 0, 255), dtype=np.uint8)


def usable(fits: CornerFits, corners: Array, side: float) -> NDArray[np.bool_]:
    """Which fits are corners: near their detection, with the residuals and the contrast of the others."""
    good = fits.good & (np.linalg.norm(fits.centres - corners, axis=1) < max(1.5, 0.1 * side))
    if good.any():
        good &= fits.misfit < max(_MISFIT_OVER_MEDIAN * float(np.median(fits.misfit[good])), 0.05)
        good &= fits.contrast > 0.25 * np.median(fits.contrast[good])
    return good


def detection_of(image: GrayImage, ids: NDArray[np.int64], pixels: Array, sigma: Array, fits: CornerFits) -> Detection:
    """The marks with sharpness and contrast of the image, from the fits."""
    order = np.argsort(ids)
    marks = Marks(ids[order], pixels[order], sigma[order])
    if not fits.good.any():
        return Detection(marks, float("nan"), float("nan"), image.saturated)
    contrast = (fits.contrast / np.maximum(fits.level, 1e-12))[fits.good]
    blur = float(np.median(fits.blur_px[fits.good]))
    return Detection(marks, blur, float(np.clip(np.median(contrast), 0, 1)), image.saturated)


def shorter_side(corners: Array, board: Board) -> float:
    """Median of the shorter sides of the squares, pixels; ``corners`` are all corners by rows."""
    columns, rows = board.grid
    grid = corners.reshape(rows, columns, 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)[:-1]
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2)[:, :-1]
    return float(np.median(np.minimum(across, down)))


def _corners(eight_bit_image: Eight, grid: tuple[int, int], *, quick: bool) -> Array | None:
    """Detect by OpenCV's two methods, the newer first; large images are searched in a smaller copy as well."""
    scale = max(1.0, max(eight_bit_image.shape) / _QUICK_SIDE) if quick else 1.0
    small = (
        eight_bit_image
        if scale == 1
        else cv2.resize(eight_bit_image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    )
    ok, corners = cv2.findChessboardCornersSB(small, grid, flags=cv2.CALIB_CB_NORMALIZE_IMAGE if quick else _THOROUGH)
    if not ok:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        ok, corners = cv2.findChessboardCorners(small, grid, flags=flags | (cv2.CALIB_CB_FAST_CHECK if quick else 0))
    if not ok and not quick and max(eight_bit_image.shape) > _QUICK_SIDE:
        return _corners(eight_bit_image, grid, quick=True)
    if not ok or len(corners) != grid[0] * grid[1]:
        return None
    return (corners.reshape(-1, 2).astype(np.float64) + 0.5) * scale - 0.5


def _right_handed(corners: Array, board: Board) -> Array:
    """Reorder the corners so that rows and columns form a right-handed grid, never a mirrored one."""
    columns, rows = board.grid
    grid = corners.reshape(rows, columns, 2)
    along, down = (np.diff(grid, axis=axis).mean(axis=(0, 1)) for axis in (1, 0))
    if along[0] * down[1] - along[1] * down[0] < 0:
        grid = grid[:, ::-1]
    return np.ascontiguousarray(grid.reshape(-1, 2))


def _by_colour(fits: CornerFits, board: Board) -> list[tuple[int, ...]]:
    """Numberings in which the square at the upper left of mark 0 is black, or all where the board has no such one."""
    every = symmetries(Board("circles", board.columns, board.rows, board.pitch_mm))
    white = (np.indices((board.rows, board.columns)).sum(axis=0) % 2 == 1).ravel()
    turned = np.arange(len(white))
    # After a quarter turn the fit's first quadrant lies on another side of the corner, where the colour is the other.
    quarter = [_is_quarter(np.array(choice)[turned], board) for choice in every]
    good = fits.good
    agreement = [
        float(((fits.light_first ^ q) == white[np.array(choice)])[good].mean()) if good.any() else 0.0
        for choice, q in zip(every, quarter, strict=True)
    ]
    chosen = [choice for choice, share in zip(every, agreement, strict=True) if share > 0.5]
    return chosen or list(every)


def _is_quarter(choice: NDArray[np.int64], board: Board) -> bool:
    """Whether a numbering exchanges rows and columns."""
    return bool(abs(int(choice[1]) - int(choice[0])) != 1) if board.columns > 1 else False


def _without(eight_bit_image: Eight, corners: Array, board: Board) -> Eight:
    """The image with the board masked, for the detection of a second one."""
    columns, rows = board.grid
    at = board.points[:, :2] / board.pitch_mm
    plane, _ = cv2.findHomography(at, corners, 0)
    edge = np.array([[-1.2, -1.2], [columns + 0.2, -1.2], [columns + 0.2, rows + 0.2], [-1.2, rows + 0.2]])
    outline = cv2.perspectiveTransform(edge[None], plane)[0]
    masked = eight_bit_image.copy()
    cv2.fillConvexPoly(masked, np.round(outline).astype(np.int32), int(np.median(eight_bit_image)))
    return masked


def _shows_something(image: GrayImage) -> bool:
    """Whether the image holds more than noise: in a stretched even image OpenCV detects small boards."""
    values = np.asarray(image.values, dtype=np.float32)
    smooth = cv2.GaussianBlur(values, (0, 0), _SMOOTH_PX)
    low, high = np.quantile(smooth[::4, ::4], [0.002, 0.998])
    # Of white noise the smoothed image keeps 1 / (2 sqrt(pi) sigma): a range of less than one deviation.
    return bool(high - low > _OVER_NOISE * 1.4826 * float(np.median(np.abs(values - smooth))))


def _reason(image: GrayImage, eight_bit_image: Eight, board: Board) -> Exception:
    """The error for an image without the board: another size, only a part, or nothing."""
    if not _shows_something(image):
        return errors.nothing(board, image)
    scale = max(1.0, max(eight_bit_image.shape) / _QUICK_SIDE)
    small = (
        eight_bit_image
        if scale == 1
        else cv2.resize(eight_bit_image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    )
    ok, corners, meta = cv2.findChessboardCornersSBWithMeta(
        small, (3, 3), cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
    )
    if ok and meta is not None:
        rows, columns = (int(count) for count in meta.shape[:2])
        pixels = corners.reshape(-1, 2) * scale
        smaller = rows * columns < board.columns * board.rows
        if smaller and errors.runs_out(image, pixels, float(np.linalg.norm(pixels[1] - pixels[0]))):
            return errors.too_few(board, len(corners), image)
        if sorted((rows, columns)) != sorted(board.grid):
            return errors.wrong_size(board, max(columns, rows), min(columns, rows))
        return errors.too_few(board, len(corners), image)
    return errors.nothing(board, image)
