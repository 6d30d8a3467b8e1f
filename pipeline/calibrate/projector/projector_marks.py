"""Marks of a board on the projector's image, from the absolute phases around them.

A projector detects nothing, but every white pixel of a camera gives the projector pixel that lights it. Around a mark
the white board gives a smooth map from camera to projector pixels: a homography (the board is flat) and what the lenses
add to it, fitted in a window. It is evaluated at the image of the mark's own point. For a circle that is not the
centroid of its image; the difference comes from the smooth map board -> camera of all marks. The dark mark itself has
little light and is left out, with the pixels near its edge whose phases mix both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.projector.absolute_phase import Coordinate
from pipeline.calibrate.projector.plane_map import SmoothMap
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import Marks
from pipeline.common.errors import TargetError
from pipeline.geometry.homography import homography, mapped

F64: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]

WINDOWS = ((0.8, 3), (1.2, 3), (1.2, 2))
"""Radius of the window around a mark, in pitches, and pixels left out at dark edges: the first with enough pixels is
used. Most marks use the first; boards with much black need a wider window."""
_BEYOND = 0.45
"""Extent of the white board that is used beyond the outermost marks, in pitches."""
_WHITE_SHARE = 0.7
_FEWEST_PIXELS = 60
_FEWEST_MARKS = 4
_SIDE_SHARE = 0.05
_FOR_HOMOGRAPHY = 20_000
_OUTLIER = 5.0
_SMALLEST_OUTLIER_PX = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class CameraObservation:
    """One camera's measurements of a view: the board's marks, and the projector coordinates of its pixels."""

    marks: Marks
    x: Coordinate
    y: Coordinate


@dataclass(frozen=True, slots=True, eq=False)
class ProjectorMarks:
    """Marks of a view on the projector's image.

    Args:
        marks: the estimates of all cameras combined, images of points.
        by_camera: each camera's own estimate.
        disagreement_px: root mean square difference of two cameras' coordinates of the marks kept; NaN with one.
        expected_px: the same by the estimates' sigma.
        rejected: marks whose estimates by the cameras differ too much.
        failed: why a camera gave no marks, by its name.
    """

    marks: Marks
    by_camera: dict[str, Marks]
    disagreement_px: float
    expected_px: float
    rejected: NDArray[np.int64]
    failed: dict[str, str]


def projector_marks(board: Board, observations: Mapping[str, CameraObservation]) -> ProjectorMarks:
    """Marks of a view on the projector's image, from one or two cameras.

    Raises:
        TargetError: no camera gives any mark; the message names the reasons.
    """
    estimates: dict[str, Marks] = {}
    failed: dict[str, str] = {}
    for name, one in observations.items():
        try:
            estimates[name] = marks_by_camera(board, one.marks, one.x, one.y)
        except TargetError as error:
            failed[name] = str(error)
    if not estimates:
        raise TargetError(
            "; ".join(f"{name}: {reason}" for name, reason in failed.items()) or "no camera detected the board"
        )
    return _combined(estimates, failed)


def marks_by_camera(board: Board, marks: Marks, x: Coordinate, y: Coordinate) -> Marks:
    """Marks on the projector's image by one camera.

    Args:
        marks: in the camera's image, centroids of circles (with ``areas_px``) or images of points.
        x, y: projector coordinates of the camera's pixels.

    Raises:
        TargetError: fewer than 4 marks have the phases of enough white pixels around them.
    """
    if len(marks) < _FEWEST_MARKS:
        raise TargetError(f"{len(marks)} marks detected, at least {_FEWEST_MARKS} are needed")
    plane = board.points[marks.ids, :2]
    view, centres = _points_of_centroids(board, marks, plane)
    good = x.valid & y.valid
    white = (x.mean + y.mean) / 2
    field = _Field(good, white, x, y)
    homography_ = _projector_homography(field, centres)
    low, high = plane.min(axis=0) - _BEYOND * board.pitch_mm, plane.max(axis=0) + _BEYOND * board.pitch_mm
    found = []
    for k, centre in enumerate(centres):
        slope = view.slope(plane[k : k + 1])[0]
        tries = (
            _fitted(field, homography_, centre, plane[k], slope, reach * board.pitch_mm, edge_px, (low, high))
            for reach, edge_px in WINDOWS
        )
        fit = next((one for one in tries if one is not None), None)
        if fit is not None:
            moved = float(np.sqrt((fit.slope**2).sum() / 2)) * float(marks.sigma_px[k])
            found.append((k, fit.value, float(np.hypot(fit.sigma, moved))))
    if len(found) < _FEWEST_MARKS:
        raise TargetError(_few_marks_text(len(found), field, centres))
    kept = np.array([k for k, _, _ in found])
    return Marks(marks.ids[kept], np.stack([value for _, value, _ in found]), np.array([s for _, _, s in found]))


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    good: Bools
    white: F64
    x: Coordinate
    y: Coordinate


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Projector pixel (2,) at a place, its standard deviation per coordinate, and d projector / d camera, (2, 2)."""

    value: F64
    sigma: float
    slope: F64


def _points_of_centroids(board: Board, marks: Marks, plane: F64) -> tuple[SmoothMap, F64]:
    """The map board -> image, and the images of the marks' own points, (n, 2)."""
    view = SmoothMap.fitted(plane, marks.pixels, marks.sigma_px)
    if marks.areas_px is None or not board.round:
        return view, marks.pixels
    centres = marks.pixels
    for _ in range(2):
        scale = np.abs(np.linalg.det(view.slope(plane)))
        radius = float(np.median(np.sqrt(marks.areas_px / (np.pi * scale))))
        centres = marks.pixels - view.centroid_shift(plane, radius)
        view = SmoothMap.fitted(plane, centres, marks.sigma_px)
    return view, centres


def _projector_homography(field: _Field, centres: F64) -> F64:
    """(3, 3) camera pixels -> projector pixels over the area of the marks, robust against other surfaces."""
    area = np.zeros(field.good.shape, np.uint8)
    cv2.fillConvexPoly(area, cv2.convexHull(np.rint(centres).astype(np.int32)), 1)
    v, u = np.nonzero(field.good & (area > 0))
    if len(u) < _FEWEST_PIXELS:
        raise TargetError(_few_marks_text(0, field, centres))
    step = max(1, len(u) // _FOR_HOMOGRAPHY)
    u, v = u[::step], v[::step]
    source = np.stack([u, v], axis=1).astype(np.float64)
    target = np.stack([field.x.px[v, u], field.y.px[v, u]], axis=1)
    return homography(source, target)[0]


def _fitted(
    field: _Field,
    whole: F64,
    centre: F64,
    place: F64,
    slope: F64,
    reach_mm: float,
    edge_px: int,
    limits: tuple[F64, F64],
) -> _Fit | None:
    """The projector pixel at ``centre`` from the white pixels around it, None where there are too few.

    Args:
        whole: homography that the fit is a correction of.
        centre: camera pixel; position: the same on the board, mm; slope: (2, 2) d pixel / d mm.
        reach_mm: radius of the window; edge_px: how much is left out at dark edges.
        limits: lowest and highest position on the board that is used, mm.
    """
    height, width = field.good.shape
    half = reach_mm * np.sqrt((slope**2).sum(axis=1)) + edge_px + 1
    left, top = np.maximum(np.floor(centre - half), 0).astype(int)
    right, bottom = np.minimum(np.ceil(centre + half) + 1, (width, height)).astype(int)
    if right - left < 3 or bottom - top < 3:
        return None
    part = np.s_[top:bottom, left:right]
    rows, columns = np.mgrid[top:bottom, left:right].astype(np.float64)
    away = np.stack([columns - centre[0], rows - centre[1]], axis=-1)
    board = away @ np.linalg.inv(slope).T
    inside = (board**2).sum(axis=-1) <= reach_mm**2
    inside &= ((board + place >= limits[0]) & (board + place <= limits[1])).all(axis=-1)
    chosen = _white(field, part, inside, edge_px) & inside
    if np.count_nonzero(chosen) < _FEWEST_PIXELS or not _all_around(board[chosen]):
        return None
    source = np.stack([columns[chosen], rows[chosen]], axis=1)
    target = np.stack([field.x.px[part][chosen], field.y.px[part][chosen]], axis=1)
    sigma = np.stack([field.x.sigma_px[part][chosen], field.y.sigma_px[part][chosen]], axis=1)
    scale = float(np.abs(away[chosen]).max())
    x, y = away[chosen].T / scale
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    rest = target - mapped(whole, source)
    fits = [_robust(design, rest[:, c], sigma[:, c]) for c in range(2)]
    value = mapped(whole, centre[None])[0] + [solution[0] for solution, _ in fits]
    variance = sum(covariance[0, 0] for _, covariance in fits) / 2
    gradient = _slope_of(whole, centre) + np.stack([solution[1:3] for solution, _ in fits]) / scale
    return _Fit(value, float(np.sqrt(variance)), gradient)


def _white(field: _Field, part: tuple[slice, slice], inside: Bools, edge_px: int) -> Bools:
    """White pixels with a phase, away from the edges of anything dark."""
    level = field.white[part]
    if not inside.any():
        return inside
    bright = level >= _WHITE_SHARE * np.quantile(level[inside], 0.9)
    # The pixels around a patch count as bright, or the window's own border would be an edge.
    core = cv2.erode(bright.astype(np.uint8), np.ones((2 * edge_px + 1,) * 2, np.uint8))
    return np.asarray((core > 0) & field.good[part])


def _all_around(away: F64) -> bool:
    """Whether the pixels lie on all sides of the position, so that evaluation is no extrapolation."""
    angles = np.arange(8) * (np.pi / 4)
    side = away @ np.stack([np.cos(angles), np.sin(angles)])
    return bool(((side > 0).mean(axis=0) >= _SIDE_SHARE).all())


def _robust(design: F64, values: F64, sigma: F64) -> tuple[F64, F64]:
    """Solution and covariance of a weighted fit; residuals beyond 3 robust deviations lose their weight (Tukey's)."""
    weight = 1 / sigma**2
    robust_weight = np.ones_like(values)
    for _ in range(4):
        w = weight * robust_weight
        normal = design.T @ (design * w[:, None])
        solution = np.linalg.solve(normal, design.T @ (w * values))
        error = (values - design @ solution) / sigma
        spread = 1.4826 * float(np.median(np.abs(error))) + 1e-12
        robust_weight = np.maximum(1 - (error / (4.685 * spread)) ** 2, 0) ** 2
    scale = float((robust_weight * error**2).sum() / max(robust_weight.sum() - design.shape[1], 1))
    return np.asarray(solution), np.asarray(np.linalg.inv(normal) * scale)


def _slope_of(matrix: F64, point: F64) -> F64:
    """Jacobian (2, 2) of a homography at a point (2,)."""
    x, y, w = matrix @ np.append(point, 1.0)
    return np.asarray((matrix[:2, :2] - np.outer([x / w, y / w], matrix[2, :2])) / w)


def _combined(estimates: dict[str, Marks], failed: dict[str, str]) -> ProjectorMarks:
    """Weighted means; marks whose positions by the two cameras differ are rejected."""
    none = np.zeros(0, np.int64)
    names = sorted(estimates)
    if len(names) == 1:
        return ProjectorMarks(estimates[names[0]], estimates, float("nan"), float("nan"), none, failed)
    a, b = estimates[names[0]], estimates[names[1]]
    both, in_a, in_b = np.intersect1d(a.ids, b.ids, return_indices=True)
    difference = a.pixels[in_a] - b.pixels[in_b]
    expected = np.hypot(a.sigma_px[in_a], b.sigma_px[in_b])
    ratio = np.abs(difference).max(axis=1, initial=0.0) / expected
    usual = max(1.0, float(np.median(ratio))) if len(ratio) else 1.0
    consistent = (ratio <= _OUTLIER * usual) | (np.abs(difference).max(axis=1, initial=0.0) <= _SMALLEST_OUTLIER_PX)
    wa, wb = 1 / a.sigma_px[in_a] ** 2, 1 / b.sigma_px[in_b] ** 2
    mean = (wa[:, None] * a.pixels[in_a] + wb[:, None] * b.pixels[in_b]) / (wa + wb)[:, None]
    alone = [one.some(~np.isin(one.ids, both)) for one in (a, b)]
    marks = Marks(
        np.concatenate([both[consistent], *(one.ids for one in alone)]),
        np.concatenate([mean[consistent], *(one.pixels for one in alone)]),
        np.concatenate([((wa + wb) ** -0.5)[consistent], *(one.sigma_px for one in alone)]),
    )
    rms = [
        float(np.sqrt((v[consistent] ** 2).mean())) if consistent.any() else float("nan")
        for v in (difference, expected)
    ]
    return ProjectorMarks(marks, estimates, rms[0], rms[1], both[~consistent].astype(np.int64), failed)


def _few_marks_text(count: int, field: _Field, centres: F64) -> str:
    height, width = field.good.shape
    u = np.clip(np.rint(centres[:, 0]).astype(int), 0, width - 1)
    v = np.clip(np.rint(centres[:, 1]).astype(int), 0, height - 1)
    box = np.s_[v.min() : v.max() + 1, u.min() : u.max() + 1]
    saturated = float((field.x.saturated[box] | field.y.saturated[box]).mean())
    reason = (
        f"{count} marks have fringes around them, at least {_FEWEST_MARKS} are needed; {100 * saturated:.0f} % of the "
    )
    reason += (
        f"board's pixels are saturated and the fringes' median amplitude is {np.median(field.x.amplitude[box]):.1f} "
    )
    return reason + "counts: " + ("lower the exposure" if saturated > 0.2 else "is the board in the projector's light?")
