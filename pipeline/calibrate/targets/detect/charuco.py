"""Detection of the corners of a ChArUco board; its markers number the corners, so part of the board is enough."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.board.charuco_board import charuco
from pipeline.calibrate.targets.detect import detection_errors as errors
from pipeline.calibrate.targets.detect.chessboard import Eight, detection_of, eight_bit, usable
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.calibrate.targets.detect.grid_completion import predicted
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


def find_charuco(image: GrayImage, board: Board, *, refine: bool = True) -> Detection:
    """The corners of a ChArUco board; see :func:`pipeline.calibrate.targets.find_marks.find_marks`."""
    eight_bit_image = eight_bit(image)
    quads, marker_ids = _markers(eight_bit_image, board)
    if refine and len(marker_ids) < _FEW_SHARE * len(charuco(board).getIds()) and eight_bit_image.size < _SMALL:
        quads, marker_ids = max(
            (quads, marker_ids), _markers(eight_bit_image, board, scale=2), key=lambda result: len(result[1])
        )
    if len(np.unique(marker_ids)) + 1 < len(marker_ids):
        raise errors.two_boards(board)
    corners, ids = _interpolated(eight_bit_image, board, quads, marker_ids)
    if len(marker_ids) >= _LEAST_MARKERS:
        _check_layout(board, quads, marker_ids)
    # The markers stand in the white squares; the fit's window must end before them.
    reach = min(0.42, 0.9 * 0.5 * (1 - board.marker_mm / board.pitch_mm) * np.sqrt(2))
    if refine:
        corners, ids = _extended(image, board, (quads, marker_ids), (corners, ids), reach)
    if not _spans(ids, board):
        raise _reason(image, eight_bit_image, board, len(ids))
    at = board.points[ids, :2] / board.pitch_mm
    fits = fit_crossings(image, corners, at, reach=reach)
    if not refine:
        return detection_of(image, ids, corners, np.full(len(ids), _SIGMA_UNREFINED_PX), fits)
    side = _side(corners, at)
    good = usable(fits, corners, side)
    if good.any() and float(np.median(fits.blur_px[good])) > _BLURRED * side:
        raise errors.too_blurred(float(np.median(fits.blur_px[good])), _BLURRED * side)
    if not _spans(ids[good], board):
        raise errors.too_few(board, int(good.sum()), image)
    return detection_of(image, ids[good], fits.centres[good], fits.sigma_px[good], fits)


def _markers(eight_bit_image: Eight, board: Board, *, scale: int = 1) -> tuple[list[Any], NDArray[np.int64]]:
    """Detect the markers: corners (1, 4, 2) and numbers; small ones are decoded better in an enlarged image."""
    detector = cv2.aruco.ArucoDetector(charuco(board).getDictionary())
    if scale > 1:
        eight_bit_image = np.asarray(
            cv2.resize(eight_bit_image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), dtype=np.uint8
        )
    quads, marker_ids, _ = detector.detectMarkers(eight_bit_image)
    quads = [((quad + 0.5) / scale - 0.5).astype(np.float32) for quad in quads]
    return quads, np.empty(0, np.int64) if marker_ids is None else marker_ids.ravel().astype(np.int64)


def _interpolated(
    eight_bit_image: Eight, board: Board, quads: list[Any], marker_ids: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Corners next to detected markers; the drawing of older OpenCV versions is tried second."""
    best = np.empty((0, 2)), np.empty(0, np.int64)
    if not len(marker_ids):
        return best
    on_board = np.isin(marker_ids, charuco(board).getIds().ravel())
    detected_quads = [quad for quad, good in zip(quads, on_board, strict=True) if good]
    for legacy in (False, True):
        detector = cv2.aruco.CharucoDetector(charuco(board, legacy=legacy))
        corners, ids, _, _ = detector.detectBoard(
            eight_bit_image, markerCorners=detected_quads, markerIds=marker_ids[on_board].astype(np.int32)[:, None]
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
    initial: tuple[Array, NDArray[np.int64]],
    reach: float,
) -> tuple[Array, NDArray[np.int64]]:
    """Add the corners whose markers were not decoded: predicted from the nearest, kept where the image confirms them.

    Small or blurred markers are decoded seldom, while their corners can still be located.
    """
    corners, ids = initial
    marker_corners = {
        int(number): np.asarray(quad)[:, :2] / board.pitch_mm - 1
        for number, quad in zip(charuco(board).getIds().ravel(), charuco(board).getObjPoints(), strict=True)
    }
    identified = [
        (marker_corners[int(n)], quad.reshape(4, 2))
        for quad, n in zip(*markers, strict=True)
        if int(n) in marker_corners
    ]
    if len(identified) < 2:
        return initial
    marker_at, marker_px = (np.concatenate(part).astype(np.float64) for part in zip(*identified, strict=True))
    at = board.points[:, :2] / board.pitch_mm
    white = (np.indices(board.grid[::-1]).sum(axis=0) % 2 == 1).ravel()
    for _ in range(max(board.grid)):
        known = np.concatenate([at[ids], marker_at]), np.concatenate([corners, marker_px])
        missing = np.setdiff1d(np.arange(len(at)), ids)
        near = [k for k in missing if (np.linalg.norm(known[0] - at[k], axis=1) < _NEAR_SQUARES).sum() >= 2]
        if not near:
            break
        guesses = np.array([_predicted(at[k], *known) for k in near])
        finite = np.isfinite(guesses).all(axis=1)
        trial, guesses = np.array(near)[finite], guesses[finite]
        if not len(trial):
            break
        all_corners, all_ids = np.concatenate([corners, guesses]), np.concatenate([ids, trial])
        fits = fit_crossings(image, all_corners, at[all_ids], reach=reach)
        good = usable(fits, all_corners, _side(all_corners, at[all_ids])) & (fits.light_first == white[all_ids])
        good = good[len(ids) :]
        if not good.any():
            break
        corners = np.concatenate([corners, fits.centres[len(ids) :][good]])
        ids = np.concatenate([ids, trial[good]])
    return corners, ids


def _predicted(position: Array, positions: Array, pixels: Array) -> Array:
    nearest = np.argsort(np.linalg.norm(positions - position, axis=1), kind="stable")[:_NEAREST]
    return predicted(position, positions[nearest], pixels[nearest])


def _spans(ids: NDArray[np.int64], board: Board) -> bool:
    """Whether there are enough marks that do not lie on one line."""
    if len(ids) < _LEAST_MARKS:
        return False
    at = board.points[ids, :2] / board.pitch_mm
    return bool(np.linalg.svd(at - at.mean(axis=0), compute_uv=False)[1] > 0.9)


def _side(corners: Array, at: Array) -> float:
    """Length of a square's shorter side, from the affine map of the whole board."""
    basis = np.column_stack([at, np.ones(len(at))])
    steps = np.linalg.lstsq(basis, corners, rcond=None)[0][:2]
    return float(np.linalg.norm(steps, axis=1).min())


def _check_layout(board: Board, quads: list[Any], marker_ids: NDArray[np.int64]) -> None:
    """Require the markers to be arranged as on a board of this many columns.

    Raises:
        TargetError: their arrangement is that of another board, or of none.
    """
    marker_count = len(charuco(board).getIds())
    centres = np.array([quad.reshape(4, 2).mean(axis=0) for quad in quads])
    best_share = max(_share(centres, marker_ids, board.columns, first) for first in (0, 1))
    if best_share >= _FIT_SHARE and marker_ids.max() < marker_count:
        return
    if best_share >= _FIT_SHARE:
        stray = marker_ids[marker_ids >= marker_count]
        if len(stray) < _LEAST_MARKERS:
            return
        rows = int(np.ceil(2 * (marker_ids.max() + 1) / board.columns))
        raise errors.wrong_size(board, board.columns - 1, rows - 1)
    shares = {c: max(_share(centres, marker_ids, c, first) for first in (0, 1)) for c in range(3, _MOST_COLUMNS + 1)}
    columns = max(shares, key=lambda c: shares[c])
    if shares[columns] >= _FIT_SHARE and shares[columns] > best_share:
        rows = int(np.ceil(2 * (int(marker_ids.max()) + 1) / columns))
        raise errors.wrong_size(board, columns - 1, rows - 1)
    raise TargetError(
        f"the {len(marker_ids)} markers in the image are not arranged as on the board {board}; give the board used "
        "and its dictionary, and leave only this board in the image"
    )


def _share(centres: Array, marker_ids: NDArray[np.int64], columns: int, first: int) -> float:
    """Share of the markers at the positions of a board with so many columns; ``first``: row that begins white."""
    rows = 2 * (int(marker_ids.max()) // columns + 2)
    row, column = np.nonzero(np.add.outer(np.arange(rows), np.arange(columns)) % 2 != first)
    at = np.stack([column, row], axis=1).astype(np.float64)[marker_ids]
    plane, inliers = cv2.findHomography(centres, at, cv2.RANSAC, _FITS_SQUARES)
    return 0.0 if plane is None or inliers is None else float(inliers.mean())


def _reason(image: GrayImage, eight_bit_image: Eight, board: Board, count: int) -> TargetError:
    if count:
        return errors.too_few(board, count, image)
    if len(_markers(np.ascontiguousarray(eight_bit_image[:, ::-1]), board)[1]) >= _LEAST_MARKERS:
        return errors.mirrored(board)
    return errors.nothing(board, image)
