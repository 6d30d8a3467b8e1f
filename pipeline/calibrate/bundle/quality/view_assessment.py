"""Which views are still missing for a calibration that can be trusted, in words and numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.quality.view_coverage import CELLS, Look, looks, pooled
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView
from pipeline.common.errors import CalibrationError
from pipeline.rig.camera_model import CameraModel

if TYPE_CHECKING:
    from pipeline.calibrate.bundle.solution import Solution

Array = NDArray[np.float64]

TARGET_VIEWS = 10
TARGET_TILT_DEG = 20.0
"""Wanted to both sides about both axes."""
TARGET_COVERAGE = 0.85
"""Share of the cells of each camera's image that hold marks in some view."""
TARGET_DISTANCE_RATIO = 1.08
"""Furthest over nearest distance."""
LEAST_TILT_DEG = 8.0
"""Sets whose largest tilt stays below this do not determine the focal length."""
LEAST_COVERAGE = 0.2
_ALIKE_SHIFT, _ALIKE_TURN, _SAME_TILT = 0.03, 0.02, 0.05

# (tilt about x, about y, degrees; place as steps from the middle; distance as a step)
_WISHES = [
    (0, 0, 0, 0, 0), (30, 0, 0, -1, 0), (-30, 0, 0, 1, 0), (0, 30, -1, 0, 0), (0, -30, 1, 0, 0), (24, 24, -1, -1, -1),
    (-24, -24, 1, 1, 1), (24, -24, 1, -1, 1), (-24, 24, -1, 1, -1), (40, 0, 1, 0, 1), (0, 40, 0, 1, -1),
    (-40, 0, -1, 0, -1), (0, -40, 0, -1, 1), (15, 0, -1, -1, 0), (-15, 0, 1, 1, 0), (0, 15, 1, -1, 0),
    (0, -15, -1, 1, 0),
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Pose:
    """A place where the board should be shown next.

    Args:
        tilt_x_deg: about the image's x axis; positive: the lower edge is further away.
        tilt_y_deg: about the image's y axis; positive: the right edge is further away.
        place: (u, v) of the board's middle in the left image, shares from 0 to 1.
        distance: of the usual distance so far (1 = the same).
        text: the same for a person.
    """

    tilt_x_deg: float
    tilt_y_deg: float
    place: tuple[float, float]
    distance: float
    text: str


@dataclass(frozen=True, slots=True)
class ViewAssessment:
    """What a set of views has, and what it lacks.

    Args:
        views: how many can be used.
        tilt_x_deg, tilt_y_deg: (least, largest) tilt about the image's axes.
        largest_tilt_deg: of all views, about any axis, as seen from between the cameras.
        coverage: by device, share of its image's cells that hold marks.
        cells: by device, (rows, columns) of booleans as nested tuples, for a map.
        distances: furthest over nearest.
        missing: sentences; empty: nothing is missing.
        next_pose: the pose that would add most.
        degenerate: why nothing can be computed from these views; empty: it can.
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


def missing(
    board: Board,
    views: Sequence[BoardView],
    sizes: Mapping[str, tuple[int, int]],
    *,
    solution: Solution | None = None,
    start: Mapping[str, CameraModel] | None = None,
) -> ViewAssessment:
    """What is missing. Works from the first view on; a solution or known devices make the tilts' signs surer.

    Args:
        board: what is shown.
        views: so far.
        sizes: (width, height) by device, the ones to be calibrated.
        solution: of these views, if there is one.
        start: known devices.
    """
    known = dict(start or {}) | (solution.devices if solution is not None else {})
    seen = {name: looks(board, views, name, size, model=known.get(name)) for name, size in sizes.items()}
    cameras = {name: some for name, some in seen.items() if name != "projector"} or seen
    together = pooled(cameras)
    coverage = {name: _coverage(some) for name, some in seen.items()}
    tilts_x = [look.tilt_x_deg for look in together.values()] or [0.0]
    tilts_y = [look.tilt_y_deg for look in together.values()] or [0.0]
    distance = [look.distance_mm for look in together.values()] or [1.0]
    wanted = _wanted(together, tilts_x, tilts_y, {name: coverage[name] for name in cameras}, cameras, distance)
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
        max((_tilt(look) for look in together.values()), default=0.0),
        coverage,
        {name: _cells(some) for name, some in seen.items()},
        max(distance) / min(distance),
        tuple(wanted),
        _next(list(together.values())),
        _degenerate(together, coverage),
        numbers,
    )


def require_non_degenerate(advice: ViewAssessment) -> None:
    """Raise if the views cannot be calibrated from.

    Raises:
        CalibrationError: why, and what to add.
    """
    if advice.degenerate:
        raise CalibrationError(f"{advice.degenerate}; {missing_views_text(advice)}")


def missing_views_text(advice: ViewAssessment) -> str:
    """One sentence for messages."""
    wishes = "; ".join(advice.missing[:4]) or "more views"
    return f"add: {wishes} (next: {advice.next_pose.text})"


def _coverage(some: dict[int, Look]) -> float:
    if not some:
        return 0.0
    return float(np.any([look.cells for look in some.values()], axis=0).mean())


def _cells(some: dict[int, Look]) -> tuple[tuple[bool, ...], ...]:
    together = np.any([look.cells for look in some.values()], axis=0) if some else np.zeros(CELLS[::-1], dtype=bool)
    return tuple(tuple(bool(cell) for cell in row) for row in together)


def _wanted(
    together: dict[int, Look], tilts_x: list[float], tilts_y: list[float], coverage: dict[str, float],
    cameras: dict[str, dict[int, Look]], distance: list[float]
) -> list[str]:  # fmt: skip
    wishes = []
    if len(together) < TARGET_VIEWS:
        wishes.append(f"{TARGET_VIEWS - len(together)} more views ({len(together)} of {TARGET_VIEWS})")
    for axis, tilts, edges in (("horizontal", tilts_x, ("lower", "upper")), ("vertical", tilts_y, ("right", "left"))):
        for edge, largest in zip(edges, (max(tilts), -min(tilts)), strict=True):
            if largest < TARGET_TILT_DEG:
                wishes.append(
                    f"a tilt of about 30 degrees about the {axis} axis, {edge} edge away "
                    f"(now {max(round(largest), 0)} degrees)"
                )
    for name, share in coverage.items():
        if share < TARGET_COVERAGE:
            where = _empty_corners(_cells(cameras[name]))
            wishes.append(f"views that reach {where} of the {name} image ({share:.0%} of it covered)")
    if max(distance) / min(distance) < TARGET_DISTANCE_RATIO:
        wishes.append(
            f"views nearer and further away by 5 to 10 % (distances differ by {max(distance) / min(distance) - 1:.0%})"
        )
    return wishes


def _tilt(look: Look) -> float:
    return float(np.hypot(look.tilt_x_deg, look.tilt_y_deg))


def _empty_corners(cells: tuple[tuple[bool, ...], ...]) -> str:
    corners = {
        "the upper left corner": cells[0][0],
        "the upper right corner": cells[0][-1],
        "the lower left corner": cells[-1][0],
        "the lower right corner": cells[-1][-1],
    }
    empty = [name for name, full in corners.items() if not full]
    return " and ".join(empty) if empty else "the edges"


def _degenerate(together: dict[int, Look], coverage: dict[str, float]) -> str:
    if len(together) < 2:
        return ""
    some = list(together.values())
    places = np.array([look.place for look in some])
    turns = np.array([look.turn.ravel() for look in some])
    sizes = np.array([look.size for look in some])
    spread = max(float(np.ptp(places, axis=0).max()), float(np.ptp(np.log(sizes))))
    turned = float(np.ptp(turns, axis=0).max())
    if spread < _ALIKE_SHIFT and turned < _ALIKE_TURN:
        return f"the {len(some)} views are all alike: the board stands at one place and hardly turns"
    largest = max(_tilt(look) for look in some)
    if largest < LEAST_TILT_DEG:
        return (
            f"the board is never tilted by more than {largest:.1f} degrees (limit {LEAST_TILT_DEG:g}): focal length "
            "and distance cannot be told apart"
        )
    if turned < _SAME_TILT:
        return "the board has nearly the same tilt in all views, which counts as a single view"
    for name, share in coverage.items():
        if 0 < share < LEAST_COVERAGE:
            return (
                f"the board covers {share:.0%} of the {name} image in all views together (limit "
                f"{LEAST_COVERAGE:.0%}): the lens outside is unknown; show it nearer, or at more places"
            )
    return ""


def _next(some: list[Look]) -> Pose:
    """The wish that is furthest from all views so far."""
    size = float(np.median([look.size for look in some])) if some else 0.6
    distance = float(np.median([look.distance_mm for look in some])) if some else 1.0
    room = float(np.clip((1.05 - size) / 2, 0.05, 0.3))

    def far(wish: tuple[int, int, int, int, int]) -> float:
        tilt_x, tilt_y, right, down, away = wish
        return min(
            (
                ((look.tilt_x_deg - tilt_x) / 20) ** 2
                + ((look.tilt_y_deg - tilt_y) / 20) ** 2
                + 0.5 * ((look.place[0] - 0.5) / room - right) ** 2
                + 0.5 * ((look.place[1] - 0.5) / room - down) ** 2
                + 0.5 * ((look.distance_mm / distance - 1) / 0.07 - away) ** 2
                for look in some
            ),
            default=0.0,
        )

    tilt_x, tilt_y, right, down, away = max(_WISHES, key=far)
    text = ", ".join(filter(None, [_tilt_words(tilt_x, tilt_y), _place_words(right, down), _distance_words(away)]))
    place = (0.5 + room * right, 0.5 + room * down)
    return Pose(float(tilt_x), float(tilt_y), place, 1 + 0.07 * away, text)


def _tilt_words(tilt_x: int, tilt_y: int) -> str:
    words = []
    if tilt_x:
        words.append(f"{'lower' if tilt_x > 0 else 'upper'} edge away by {abs(tilt_x)} degrees")
    if tilt_y:
        words.append(f"{'right' if tilt_y > 0 else 'left'} edge away by {abs(tilt_y)} degrees")
    return " and ".join(words) or "facing the cameras"


def _place_words(right: int, down: int) -> str:
    words = [{-1: "upper", 1: "lower"}.get(down, ""), {-1: "left", 1: "right"}.get(right, "")]
    where = " ".join(filter(None, words))
    if not where:
        return "in the middle of the image"
    return f"towards the {where} {'corner' if ' ' in where else 'edge'} of the image"


def _distance_words(away: int) -> str:
    return {-1: "about 7 % nearer", 1: "about 7 % further away"}.get(away, "")
