"""Assessment of a set of views: coverage, tilts, distances, and the views that are still missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.quality.view_coverage import CELLS, ViewGeometry, pooled, view_geometries
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView
from pipeline.common.errors import CalibrationError
from pipeline.rig.camera_model import CameraModel

if TYPE_CHECKING:
    from pipeline.calibrate.bundle.solution import Solution

Array = NDArray[np.float64]

TARGET_VIEWS = 10
TARGET_TILT_DEG = 20.0
"""To both sides about both axes."""
TARGET_COVERAGE = 0.85
"""Share of the cells of each camera's image that hold marks in some view."""
TARGET_DISTANCE_RATIO = 1.08
"""Furthest over nearest distance."""
LEAST_TILT_DEG = 8.0
"""Sets whose largest tilt stays below this do not determine the focal length."""
LEAST_COVERAGE = 0.2
_ALIKE_SHIFT, _ALIKE_TURN, _SAME_TILT = 0.03, 0.02, 0.05

# (tilt about x, about y, degrees; position as steps from the middle; distance as a step)
_POSES = [
    (0, 0, 0, 0, 0), (30, 0, 0, -1, 0), (-30, 0, 0, 1, 0), (0, 30, -1, 0, 0), (0, -30, 1, 0, 0), (24, 24, -1, -1, -1),
    (-24, -24, 1, 1, 1), (24, -24, 1, -1, 1), (-24, 24, -1, 1, -1), (40, 0, 1, 0, 1), (0, 40, 0, 1, -1),
    (-40, 0, -1, 0, -1), (0, -40, 0, -1, 1), (15, 0, -1, -1, 0), (-15, 0, 1, 1, 0), (0, 15, 1, -1, 0),
    (0, -15, -1, 1, 0),
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose in which the board should be shown next.

    Args:
        tilt_x_deg: about the image's x axis; positive: the lower edge is further away.
        tilt_y_deg: about the image's y axis; positive: the right edge is further away.
        position: (u, v) of the board's middle in the left image, shares from 0 to 1.
        distance: relative to the median distance so far (1 = the same).
        text: the same for the user.
    """

    tilt_x_deg: float
    tilt_y_deg: float
    position: tuple[float, float]
    distance: float
    text: str


@dataclass(frozen=True, slots=True)
class ViewAssessment:
    """What a set of views has and what is missing.

    Args:
        views: number that can be used.
        tilt_x_deg, tilt_y_deg: (least, largest) tilt about the image's axes.
        largest_tilt_deg: of all views, about any axis, relative to the middle between the cameras.
        coverage: by device, share of its image's cells that hold marks.
        cells: by device, (rows, columns) of booleans as nested tuples, for a map.
        distances: furthest over nearest.
        missing: sentences; empty: nothing is missing.
        next_pose: the pose that would add most.
        degenerate: why these views cannot be calibrated; empty: they can.
    """

    views: int
    tilt_x_deg: tuple[float, float]
    tilt_y_deg: tuple[float, float]
    largest_tilt_deg: float
    coverage: dict[str, float]
    cells: dict[str, tuple[tuple[bool, ...], ...]]
    distances: float
    missing: tuple[str, ...]
    next_pose: Pose
    degenerate: str = ""
    progress: dict[str, float] = field(default_factory=dict)

    @property
    def enough(self) -> bool:
        """Whether nothing is missing."""
        return not self.missing


def assess_views(
    board: Board,
    views: Sequence[BoardView],
    sizes: Mapping[str, tuple[int, int]],
    *,
    solution: Solution | None = None,
    start: Mapping[str, CameraModel] | None = None,
) -> ViewAssessment:
    """Assess a set of views, from the first on; a solution or known devices improve the signs of the tilts.

    Args:
        board: what is shown.
        views: so far.
        sizes: (width, height) by device, the ones to be calibrated.
        solution: of these views, if there is one.
        start: known devices.
    """
    models = dict(start or {}) | (solution.devices if solution is not None else {})
    geometries = {
        name: view_geometries(board, views, name, size, model=models.get(name)) for name, size in sizes.items()
    }
    cameras = {name: views for name, views in geometries.items() if name != "projector"} or geometries
    together = pooled(cameras)
    coverage = {name: _coverage(views) for name, views in geometries.items()}
    tilts_x = [geometry.tilt_x_deg for geometry in together.values()] or [0.0]
    tilts_y = [geometry.tilt_y_deg for geometry in together.values()] or [0.0]
    distance = [geometry.distance_mm for geometry in together.values()] or [1.0]
    lacking = _missing(together, tilts_x, tilts_y, {name: coverage[name] for name in cameras}, cameras, distance)
    numbers = {
        "views": min(1.0, len(together) / TARGET_VIEWS),
        "tilt": min(1.0, max(0.0, min(max(tilts_x), -min(tilts_x), max(tilts_y), -min(tilts_y))) / TARGET_TILT_DEG),
        "coverage": min(1.0, min((coverage[name] for name in cameras), default=0.0) / TARGET_COVERAGE),
        "distance": min(1.0, (max(distance) / min(distance) - 1) / (TARGET_DISTANCE_RATIO - 1)),
    }
    return ViewAssessment(
        len(together),
        (min(tilts_x), max(tilts_x)),
        (min(tilts_y), max(tilts_y)),
        max((_tilt(geometry) for geometry in together.values()), default=0.0),
        coverage,
        {name: _cells(views) for name, views in geometries.items()},
        max(distance) / min(distance),
        tuple(lacking),
        _next(list(together.values())),
        _degenerate(together, coverage),
        numbers,
    )


def require_non_degenerate(assessment: ViewAssessment) -> None:
    """Raise if the views cannot be calibrated.

    Raises:
        CalibrationError: with the reason and the views to add.
    """
    if assessment.degenerate:
        raise CalibrationError(f"{assessment.degenerate}; {missing_views_text(assessment)}")


def missing_views_text(assessment: ViewAssessment) -> str:
    """One sentence for messages."""
    lacking = "; ".join(assessment.missing[:4]) or "more views"
    return f"add: {lacking} (next: {assessment.next_pose.text})"


def _coverage(views: dict[int, ViewGeometry]) -> float:
    if not views:
        return 0.0
    return float(np.any([geometry.cells for geometry in views.values()], axis=0).mean())


def _cells(views: dict[int, ViewGeometry]) -> tuple[tuple[bool, ...], ...]:
    together = (
        np.any([geometry.cells for geometry in views.values()], axis=0) if views else np.zeros(CELLS[::-1], dtype=bool)
    )
    return tuple(tuple(bool(cell) for cell in row) for row in together)


def _missing(
    together: dict[int, ViewGeometry], tilts_x: list[float], tilts_y: list[float], coverage: dict[str, float],
    cameras: dict[str, dict[int, ViewGeometry]], distance: list[float]
) -> list[str]:  # fmt: skip
    lacking = []
    if len(together) < TARGET_VIEWS:
        lacking.append(f"{TARGET_VIEWS - len(together)} more views ({len(together)} of {TARGET_VIEWS})")
    for axis, tilts, edges in (("horizontal", tilts_x, ("lower", "upper")), ("vertical", tilts_y, ("right", "left"))):
        for edge, largest in zip(edges, (max(tilts), -min(tilts)), strict=True):
            if largest < TARGET_TILT_DEG:
                lacking.append(
                    f"a tilt of about 30 degrees about the {axis} axis, {edge} edge away "
                    f"(now {max(round(largest), 0)} degrees)"
                )
    for name, share in coverage.items():
        if share < TARGET_COVERAGE:
            where = _empty_corners(_cells(cameras[name]))
            lacking.append(f"views that reach {where} of the {name} image ({share:.0%} of it covered)")
    if max(distance) / min(distance) < TARGET_DISTANCE_RATIO:
        lacking.append(
            f"views nearer and further away by 5 to 10 % (distances differ by {max(distance) / min(distance) - 1:.0%})"
        )
    return lacking


def _tilt(geometry: ViewGeometry) -> float:
    return float(np.hypot(geometry.tilt_x_deg, geometry.tilt_y_deg))


def _empty_corners(cells: tuple[tuple[bool, ...], ...]) -> str:
    corners = {
        "the upper left corner": cells[0][0],
        "the upper right corner": cells[0][-1],
        "the lower left corner": cells[-1][0],
        "the lower right corner": cells[-1][-1],
    }
    empty = [name for name, full in corners.items() if not full]
    return " and ".join(empty) if empty else "the edges"


def _degenerate(together: dict[int, ViewGeometry], coverage: dict[str, float]) -> str:
    if len(together) < 2:
        return ""
    views = list(together.values())
    positions = np.array([geometry.position for geometry in views])
    turns = np.array([geometry.turn.ravel() for geometry in views])
    sizes = np.array([geometry.size for geometry in views])
    spread = max(float(np.ptp(positions, axis=0).max()), float(np.ptp(np.log(sizes))))
    turned = float(np.ptp(turns, axis=0).max())
    if spread < _ALIKE_SHIFT and turned < _ALIKE_TURN:
        return f"the {len(views)} views are all alike: the board has about the same position and orientation"
    largest = max(_tilt(geometry) for geometry in views)
    if largest < LEAST_TILT_DEG:
        return (
            f"the board is never tilted by more than {largest:.1f} degrees (limit {LEAST_TILT_DEG:g}): focal length "
            "and distance cannot be separated"
        )
    if turned < _SAME_TILT:
        return "the board has nearly the same tilt in all views, which counts as a single view"
    for name, share in coverage.items():
        if 0 < share < LEAST_COVERAGE:
            return (
                f"the board covers {share:.0%} of the {name} image in all views together (limit "
                f"{LEAST_COVERAGE:.0%}): the lens outside is unknown; show it nearer, or at more positions"
            )
    return ""


def _next(views: list[ViewGeometry]) -> Pose:
    """The proposed pose that is furthest from all views so far."""
    size = float(np.median([geometry.size for geometry in views])) if views else 0.6
    distance = float(np.median([geometry.distance_mm for geometry in views])) if views else 1.0
    room = float(np.clip((1.05 - size) / 2, 0.05, 0.3))

    def far(pose: tuple[int, int, int, int, int]) -> float:
        tilt_x, tilt_y, right, down, away = pose
        return min(
            (
                ((geometry.tilt_x_deg - tilt_x) / 20) ** 2
                + ((geometry.tilt_y_deg - tilt_y) / 20) ** 2
                + 0.5 * ((geometry.position[0] - 0.5) / room - right) ** 2
                + 0.5 * ((geometry.position[1] - 0.5) / room - down) ** 2
                + 0.5 * ((geometry.distance_mm / distance - 1) / 0.07 - away) ** 2
                for geometry in views
            ),
            default=0.0,
        )

    tilt_x, tilt_y, right, down, away = max(_POSES, key=far)
    text = ", ".join(filter(None, [_tilt_text(tilt_x, tilt_y), _position_text(right, down), _distance_text(away)]))
    position = (0.5 + room * right, 0.5 + room * down)
    return Pose(float(tilt_x), float(tilt_y), position, 1 + 0.07 * away, text)


def _tilt_text(tilt_x: int, tilt_y: int) -> str:
    parts = []
    if tilt_x:
        parts.append(f"{'lower' if tilt_x > 0 else 'upper'} edge away by {abs(tilt_x)} degrees")
    if tilt_y:
        parts.append(f"{'right' if tilt_y > 0 else 'left'} edge away by {abs(tilt_y)} degrees")
    return " and ".join(parts) or "facing the cameras"


def _position_text(right: int, down: int) -> str:
    parts = [{-1: "upper", 1: "lower"}.get(down, ""), {-1: "left", 1: "right"}.get(right, "")]
    where = " ".join(filter(None, parts))
    if not where:
        return "in the middle of the image"
    return f"towards the {where} {'corner' if ' ' in where else 'edge'} of the image"


def _distance_text(away: int) -> str:
    return {-1: "about 7 % nearer", 1: "about 7 % further away"}.get(away, "")
