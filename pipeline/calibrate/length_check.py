"""Check of a calibration by distances on a board, or one known length, measured from one view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.initialise.board_symmetry import symmetries
from pipeline.calibrate.bundle.quality.reprojection_error import epipolar_distances
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.localise import circle_projection
from pipeline.calibrate.targets.marks import Marks
from pipeline.common.errors import TargetError
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]

LEAST_MARKS = 6
_OFFSET_STEPS = 2


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the check.

    Args:
        ppm: of the scale: mean relative error of the distances.
        mm: of the worst distance after the scale is removed; 0 = one part in 1000 of the longest.
        epipolar_px: root mean square.
    """

    ppm: float = 500.0
    mm: float = 0.0
    epipolar_px: float = 0.5


@dataclass(frozen=True, slots=True)
class Distances:
    """Measured distances of pairs of marks against those on the board.

    Args:
        marks, pairs: counts; longest_mm: of the distances.
        mean_mm, rms_mm: of measured minus true; worst_mm: the largest of them, of marks ``worst``.
        scale_ppm: by how much distances come out too long, least squares over all pairs.
        flatness_mm: root mean square distance of the marks from their common plane.
        epipolar_px: root mean square distance of marks from the epipolar lines of their partners.
        complaints: exceeded limits, as sentences; empty: the calibration is good.
    """

    marks: int
    pairs: int
    longest_mm: float
    mean_mm: float
    rms_mm: float
    worst_mm: float
    worst: tuple[int, int]
    scale_ppm: float
    flatness_mm: float
    epipolar_px: float
    complaints: list[str] = field(default_factory=list)


def triangulated(left: CameraModel, right: CameraModel, in_left: Array, in_right: Array) -> Array:
    """Points (n, 3) in the world from pixels (n, 2) of both cameras: least squares of the four linear equations."""
    rows, sides = [], []
    for device, pixels in ((left, in_left), (right, in_right)):
        ideal = device.normalise(pixels)
        # x (R3 X + t3) = R1 X + t1, in pixels so that both cameras' noise weighs alike
        for axis in (0, 1):
            weight = device.matrix[axis, axis]
            rows.append(weight * (ideal[:, axis, None] * device.rotation[2] - device.rotation[axis]))
            sides.append(weight * (device.translation[axis] - ideal[:, axis] * device.translation[2]))
    matrix, side = np.stack(rows, axis=1), np.stack(sides, axis=1)
    points = np.linalg.solve(
        np.einsum("nki,nkj->nij", matrix, matrix), np.einsum("nki,nk->ni", matrix, side)[..., None]
    )
    return np.asarray(points[..., 0])


def check_board(cameras: Cameras, board: Board, left: Marks, right: Marks, limits: Limits) -> Distances:
    """Distances between all pairs of marks that both cameras detected.

    Raises:
        TargetError: fewer than 6 marks were detected by both.
    """
    ids, in_left, in_right = paired(cameras, board, left, right)
    if len(ids) < LEAST_MARKS:
        raise TargetError(f"{len(ids)} marks were detected by both cameras, at least {LEAST_MARKS} are needed")
    truth = board.points[ids]
    if board.round:
        in_left, in_right = _as_points(cameras, board, truth, (in_left, in_right), (left, right), ids)
    points = triangulated(cameras.left, cameras.right, in_left, in_right)
    epipolar = epipolar_distances(cameras.left, cameras.right, in_left, in_right)
    first, second = np.triu_indices(len(ids), 1)
    true = np.linalg.norm(truth[first] - truth[second], axis=1)
    error = np.linalg.norm(points[first] - points[second], axis=1) - true
    worst = int(np.abs(error).argmax())
    spread = np.linalg.svd(points - points.mean(axis=0))[1][2] / np.sqrt(len(points))
    result = Distances(
        marks=len(ids),
        pairs=len(error),
        longest_mm=float(true.max()),
        mean_mm=float(error.mean()),
        rms_mm=float(np.sqrt((error**2).mean())),
        worst_mm=float(error[worst]),
        worst=(int(ids[first[worst]]), int(ids[second[worst]])),
        scale_ppm=float(1e6 * (error @ true) / (true @ true)),
        flatness_mm=float(spread),
        epipolar_px=float(np.sqrt((epipolar**2).mean())),
    )
    result.complaints.extend(_complaints(result, error, true, limits))
    return result


def check_length(cameras: Cameras, length_mm: float, in_left: Array, in_right: Array, limits: Limits) -> Distances:
    """One known distance from the pixels (2, 2) of its two ends in both images, in any order."""
    straight = epipolar_distances(cameras.left, cameras.right, in_left, in_right)
    crossed = epipolar_distances(cameras.left, cameras.right, in_left, in_right[::-1])
    if np.abs(crossed).max() < np.abs(straight).max():
        in_right, straight = in_right[::-1], crossed
    points = triangulated(cameras.left, cameras.right, in_left, in_right)
    error = float(np.linalg.norm(points[0] - points[1])) - length_mm
    epipolar = float(np.sqrt((straight**2).mean()))
    result = Distances(2, 1, length_mm, error, abs(error), error, (0, 1), 1e6 * error / length_mm, 0.0, epipolar)
    result.complaints.extend(_complaints(result, np.array([error]), np.array([length_mm]), limits))
    return result


def paired(cameras: Cameras, board: Board, left: Marks, right: Marks) -> tuple[NDArray[np.int64], Array, Array]:
    """Marks detected by both: numbers, pixels left and right, renumbered on the right to fit the epipolar lines."""
    best: tuple[float, NDArray[np.int64], Array, Array] | None = None
    for symmetry in symmetries(board):
        if symmetry.mirrored:
            continue
        renamed = symmetry.permutation[right.ids]
        ids, at_left, at_right = np.intersect1d(left.ids, renamed, return_indices=True)
        if not len(ids):
            continue
        pixels = left.pixels[at_left], right.pixels[at_right]
        error = float(epipolar_distances(cameras.left, cameras.right, *pixels).mean())
        if best is None or error < best[0]:
            best = error, ids.astype(np.int64), *pixels
    if best is None:
        return np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2))
    return best[1], best[2], best[3]


def board_pose(points: Array, truth: Array) -> tuple[Array, Array]:
    """Rotation and translation, board to world, that bring points of the board to measured ones (Kabsch, 1976)."""
    middle, centre = points.mean(axis=0), truth.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ (truth - centre))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.asarray(rotation), np.asarray(middle - rotation @ centre)


def _as_points(
    cameras: Cameras,
    board: Board,
    truth: Array,
    pixels: tuple[Array, Array],
    marks: tuple[Marks, Marks],
    ids: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Pixels of the circles' centres from those of their images' centroids."""
    devices = (cameras.left, cameras.right)
    moved = pixels
    for _ in range(_OFFSET_STEPS):
        points = triangulated(*devices, *moved)
        rotation, place = board_pose(points, truth)
        out = []
        for device, measured, seen in zip(devices, pixels, marks, strict=True):
            r, t = device.rotation @ rotation, device.rotation @ place + device.translation
            diameter = board.diameter_mm
            if not diameter and seen.areas_px is not None and len(seen) == len(ids):
                diameter = circle_projection.diameter_mm(np.sort(seen.areas_px), device, r, t, truth)
            radius = (diameter or board.printed_diameter_mm) / 2
            out.append(measured - circle_projection.offsets(device, r, t, truth, radius))
        moved = out[0], out[1]
    return moved


def _complaints(found: Distances, error: Array, true: Array, limits: Limits) -> list[str]:
    out = []
    if abs(found.scale_ppm) > limits.ppm:
        long = "long" if found.scale_ppm > 0 else "short"
        out.append(
            f"distances come out {abs(found.scale_ppm):.0f} ppm too {long} (limit {limits.ppm:g} ppm): the baseline "
            "or a focal length changed, or the board differs from its description"
        )
    rest = float(np.abs(error - 1e-6 * found.scale_ppm * true).max())
    most = limits.mm or found.longest_mm / 1000
    if len(true) > 1 and rest > most:
        out.append(
            f"a distance is wrong by {rest:.3f} mm without the scale (limit {most:.3g} mm): a lens or a camera moved"
        )
    if found.epipolar_px > limits.epipolar_px:
        out.append(
            f"marks lie {found.epipolar_px:.2f} px rms from their epipolar lines (limit {limits.epipolar_px:g} px): a "
            "camera was rotated or a lens moved; calibrate again"
        )
    return out
