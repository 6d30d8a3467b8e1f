"""The corners of a ChArUco board in a picture; part of it is enough, because its markers tell which corner is which."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import TargetError
from pipeline.targets import found as answers
from pipeline.targets.aruco import charuco
from pipeline.targets.board import Board
from pipeline.targets.corner_fit import fit_crossings
from pipeline.targets.found import Found
from pipeline.targets.grey import GreyPicture
from pipeline.targets.squares import Eight, answer, eight_bit, usable

Array = NDArray[np.float64]

_LEAST_MARKS = 6
_LEAST_MARKERS = 4
_BLURRED = 0.15
_SIGMA_UNREFINED_PX = 0.1
_FITS_SQUARES = 0.3
_FIT_SHARE = 0.7
_MOST_COLUMNS = 40


def find_charuco(picture: GreyPicture, board: Board, *, refine: bool = True) -> Found:
    """The corners of a ChArUco board; see :func:`pipeline.targets.find.find_marks`."""
    image = eight_bit(picture)
    places, numbers = _markers(image, board)
    if len(np.unique(numbers)) + 1 < len(numbers):
        raise answers.two_boards(board)
    corners, ids = _interpolated(image, board, places, numbers)
    if len(numbers) >= _LEAST_MARKERS:
        _check_layout(board, places, numbers)
    if not _spans(ids, board):
        raise _reason(picture, image, board, len(ids))
    at = board.points[ids, :2] / board.pitch_mm
    # The markers begin in the white squares; the fit must not see them.
    free = 0.5 * (1 - board.marker_mm / board.pitch_mm) * np.sqrt(2)
    fits = fit_crossings(picture, corners, at, reach=min(0.42, 0.9 * free))
    if not refine:
        return answer(picture, ids, corners, np.full(len(ids), _SIGMA_UNREFINED_PX), fits)
    side = _side(corners, at)
    good = usable(fits, corners, side)
    if good.any() and float(np.median(fits.blur_px[good])) > _BLURRED * side:
        raise answers.too_blurred(float(np.median(fits.blur_px[good])), _BLURRED * side)
    if not _spans(ids[good], board):
        raise answers.too_few(board, int(good.sum()), picture)
    return answer(picture, ids[good], fits.centres[good], fits.sigma_px[good], fits)


def _markers(image: Eight, board: Board) -> tuple[list[Any], NDArray[np.int64]]:
    detector = cv2.aruco.ArucoDetector(charuco(board).getDictionary())
    places, numbers, _ = detector.detectMarkers(image)
    return list(places), np.empty(0, np.int64) if numbers is None else numbers.ravel().astype(np.int64)


def _interpolated(
    image: Eight, board: Board, places: list[Any], numbers: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Corners next to known markers; the drawing of older OpenCV versions is tried second."""
    best = np.empty((0, 2)), np.empty(0, np.int64)
    if not len(numbers):
        return best
    known = np.isin(numbers, charuco(board).getIds().ravel())
    seen = [place for place, good in zip(places, known, strict=True) if good]
    for legacy in (False, True):
        detector = cv2.aruco.CharucoDetector(charuco(board, legacy=legacy))
        corners, ids, _, _ = detector.detectBoard(
            image, markerCorners=seen, markerIds=numbers[known].astype(np.int32)[:, None]
        )
        if ids is not None and len(ids) > len(best[1]):
            best = corners.reshape(-1, 2).astype(np.float64), ids.ravel().astype(np.int64)
        if len(best[1]) >= _LEAST_MARKS:
            break
    return best


def _spans(ids: NDArray[np.int64], board: Board) -> bool:
    """Whether there are enough marks, and not all on one line."""
    if len(ids) < _LEAST_MARKS:
        return False
    at = board.points[ids, :2] / board.pitch_mm
    return bool(np.linalg.svd(at - at.mean(axis=0), compute_uv=False)[1] > 0.9)


def _side(corners: Array, at: Array) -> float:
    """Length of a square's shorter side, from the affine map of the whole board."""
    basis = np.column_stack([at, np.ones(len(at))])
    steps = np.linalg.lstsq(basis, corners, rcond=None)[0][:2]
    return float(np.linalg.norm(steps, axis=1).min())


def _check_layout(board: Board, places: list[Any], numbers: NDArray[np.int64]) -> None:
    """The markers must stand as on a board of this many columns.

    Raises:
        TargetError: they stand as on another one, or not as on any.
    """
    there = len(charuco(board).getIds())
    centres = np.array([place.reshape(4, 2).mean(axis=0) for place in places])
    told = max(_share(centres, numbers, board.columns, first) for first in (0, 1))
    if told >= _FIT_SHARE and numbers.max() < there:
        return
    if told >= _FIT_SHARE:
        stray = numbers[numbers >= there]
        if len(stray) < _LEAST_MARKERS:
            return
        rows = int(np.ceil(2 * (numbers.max() + 1) / board.columns))
        raise answers.wrong_size(board, board.columns - 1, rows - 1)
    shares = {c: max(_share(centres, numbers, c, first) for first in (0, 1)) for c in range(3, _MOST_COLUMNS + 1)}
    columns = max(shares, key=lambda c: shares[c])
    if shares[columns] >= _FIT_SHARE and shares[columns] > told:
        rows = int(np.ceil(2 * (int(numbers.max()) + 1) / columns))
        raise answers.wrong_size(board, columns - 1, rows - 1)
    raise TargetError(
        f"the {len(numbers)} markers in the picture do not stand as on the board {board}; tell the board that is used "
        "and its dictionary, and leave only this board in the picture"
    )


def _share(centres: Array, numbers: NDArray[np.int64], columns: int, first: int) -> float:
    """Share of the markers that are where a board of so many columns has them; ``first``: row that begins white."""
    rows = 2 * (int(numbers.max()) // columns + 2)
    row, column = np.nonzero(np.add.outer(np.arange(rows), np.arange(columns)) % 2 != first)
    at = np.stack([column, row], axis=1).astype(np.float64)[numbers]
    plane, inliers = cv2.findHomography(centres, at, cv2.RANSAC, _FITS_SQUARES)
    return 0.0 if plane is None or inliers is None else float(inliers.mean())


def _reason(picture: GreyPicture, image: Eight, board: Board, count: int) -> TargetError:
    if count:
        return answers.too_few(board, count, picture)
    if len(_markers(np.ascontiguousarray(image[:, ::-1]), board)[1]) >= _LEAST_MARKERS:
        return answers.mirrored(board)
    return answers.nothing(board, picture)
