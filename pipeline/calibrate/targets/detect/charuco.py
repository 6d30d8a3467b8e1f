"""The corners of a ChArUco board in an image; part of it is enough, because its markers tell which corner is which."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.board.charuco_board import charuco
from pipeline.calibrate.targets.detect import detection as answers
from pipeline.calibrate.targets.detect.chessboard import Eight, answer, eight_bit, usable
from pipeline.calibrate.targets.detect.detection import Found
from pipeline.calibrate.targets.localise.corner_fit import fit_crossings
from pipeline.calibrate.targets.localise.gray_image import GrayImage
from pipeline.common.errors import TargetError

Array = NDArray[np.float64]

_LEAST_MARKS = 6
_LEAST_MARKERS = 4
_BLURRED = 0.15
_SIGMA_UNREFINED_PX = 0.1
_FITS_SQUARES = 0.3
_FIT_SHARE = 0.7
_MOST_COLUMNS = 40
_FEW_SHARE = 0.7
_SMALL = 3_000_000
_NEAR_SQUARES = 1.6
_NEAREST = 16


def find_charuco(image: GrayImage, board: Board, *, refine: bool = True) -> Found:
    """The corners of a ChArUco board; see :func:`pipeline.calibrate.targets.find_marks.find_marks`."""
    eight_bit_image = eight_bit(image)
    places, numbers = _markers(eight_bit_image, board)
    if refine and len(numbers) < _FEW_SHARE * len(charuco(board).getIds()) and eight_bit_image.size < _SMALL:
        places, numbers = max(
            (places, numbers), _markers(eight_bit_image, board, scale=2), key=lambda found: len(found[1])
        )
    if len(np.unique(numbers)) + 1 < len(numbers):
        raise answers.two_boards(board)
    corners, ids = _interpolated(eight_bit_image, board, places, numbers)
    if len(numbers) >= _LEAST_MARKERS:
        _check_layout(board, places, numbers)
    # The markers begin in the white squares; the fit must not see them.
    reach = min(0.42, 0.9 * 0.5 * (1 - board.marker_mm / board.pitch_mm) * np.sqrt(2))
    if refine:
        corners, ids = _extended(image, board, (places, numbers), (corners, ids), reach)
    if not _spans(ids, board):
        raise _reason(image, eight_bit_image, board, len(ids))
    at = board.points[ids, :2] / board.pitch_mm
    fits = fit_crossings(image, corners, at, reach=reach)
    if not refine:
        return answer(image, ids, corners, np.full(len(ids), _SIGMA_UNREFINED_PX), fits)
    side = _side(corners, at)
    good = usable(fits, corners, side)
    if good.any() and float(np.median(fits.blur_px[good])) > _BLURRED * side:
        raise answers.too_blurred(float(np.median(fits.blur_px[good])), _BLURRED * side)
    if not _spans(ids[good], board):
        raise answers.too_few(board, int(good.sum()), image)
    return answer(image, ids[good], fits.centres[good], fits.sigma_px[good], fits)


def _markers(eight_bit_image: Eight, board: Board, *, scale: int = 1) -> tuple[list[Any], NDArray[np.int64]]:
    """Corners (1, 4, 2) and numbers of the markers; small ones are read better in a larger copy."""
    detector = cv2.aruco.ArucoDetector(charuco(board).getDictionary())
    if scale > 1:
        eight_bit_image = np.asarray(
            cv2.resize(eight_bit_image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), dtype=np.uint8
        )
    places, numbers, _ = detector.detectMarkers(eight_bit_image)
    places = [((place + 0.5) / scale - 0.5).astype(np.float32) for place in places]
    return places, np.empty(0, np.int64) if numbers is None else numbers.ravel().astype(np.int64)


def _interpolated(
    eight_bit_image: Eight, board: Board, places: list[Any], numbers: NDArray[np.int64]
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
            eight_bit_image, markerCorners=seen, markerIds=numbers[known].astype(np.int32)[:, None]
        )
        if ids is not None and len(ids) > len(best[1]):
            best = corners.reshape(-1, 2).astype(np.float64), ids.ravel().astype(np.int64)
        if len(best[1]) >= _LEAST_MARKS:
            break
    return best


def _extended(
    image: GrayImage,
    board: Board,
    markers: tuple[list[Any], NDArray[np.int64]],
    found: tuple[Array, NDArray[np.int64]],
    reach: float,
) -> tuple[Array, NDArray[np.int64]]:
    """Also the corners whose markers were not read: predicted from what is near, kept where the image confirms them.

    Markers are harder to read than corners to see: where they are small or blurred few are read, and all corners are
    there.
    """
    corners, ids = found
    drawn = {
        int(number): np.asarray(place)[:, :2] / board.pitch_mm - 1
        for number, place in zip(charuco(board).getIds().ravel(), charuco(board).getObjPoints(), strict=True)
    }
    read = [(drawn[int(n)], place.reshape(4, 2)) for place, n in zip(*markers, strict=True) if int(n) in drawn]
    if len(read) < 2:
        return found
    marked, seen = (np.concatenate(part).astype(np.float64) for part in zip(*read, strict=True))
    every = board.points[:, :2] / board.pitch_mm
    white = (np.indices(board.grid[::-1]).sum(axis=0) % 2 == 1).ravel()
    for _ in range(max(board.grid)):
        known = np.concatenate([every[ids], marked]), np.concatenate([corners, seen])
        missing = np.setdiff1d(np.arange(len(every)), ids)
        near = [k for k in missing if (np.linalg.norm(known[0] - every[k], axis=1) < _NEAR_SQUARES).sum() >= 2]
        if not near:
            break
        guesses = np.array([_predicted(every[k], *known) for k in near])
        finite = np.isfinite(guesses).all(axis=1)
        trial, guesses = np.array(near)[finite], guesses[finite]
        if not len(trial):
            break
        whole = np.concatenate([corners, guesses]), np.concatenate([ids, trial])
        fits = fit_crossings(image, whole[0], every[whole[1]], reach=reach)
        good = usable(fits, whole[0], _side(whole[0], every[whole[1]])) & (fits.light_first == white[whole[1]])
        good = good[len(ids) :]
        if not good.any():
            break
        corners = np.concatenate([corners, fits.centres[len(ids) :][good]])
        ids = np.concatenate([ids, trial[good]])
    return corners, ids


def _predicted(place: Array, known: Array, pixels: Array) -> Array:
    """Where a place of the board is, from the plane through what is nearest to it."""
    nearest = np.argsort(np.linalg.norm(known - place, axis=1), kind="stable")[:_NEAREST]
    plane = np.asarray(cv2.findHomography(known[nearest], pixels[nearest], 0)[0])
    if plane.shape != (3, 3):
        return np.full(2, np.nan)
    u, v, w = plane @ [*place, 1.0]
    return np.array([u / w, v / w])


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
        f"the {len(numbers)} markers in the image do not stand as on the board {board}; tell the board that is used "
        "and its dictionary, and leave only this board in the image"
    )


def _share(centres: Array, numbers: NDArray[np.int64], columns: int, first: int) -> float:
    """Share of the markers that are where a board of so many columns has them; ``first``: row that begins white."""
    rows = 2 * (int(numbers.max()) // columns + 2)
    row, column = np.nonzero(np.add.outer(np.arange(rows), np.arange(columns)) % 2 != first)
    at = np.stack([column, row], axis=1).astype(np.float64)[numbers]
    plane, inliers = cv2.findHomography(centres, at, cv2.RANSAC, _FITS_SQUARES)
    return 0.0 if plane is None or inliers is None else float(inliers.mean())


def _reason(image: GrayImage, eight_bit_image: Eight, board: Board, count: int) -> TargetError:
    if count:
        return answers.too_few(board, count, image)
    if len(_markers(np.ascontiguousarray(eight_bit_image[:, ::-1]), board)[1]) >= _LEAST_MARKERS:
        return answers.mirrored(board)
    return answers.nothing(board, image)
