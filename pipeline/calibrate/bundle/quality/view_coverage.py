"""Position, size and tilt of the board in each view of each device, without a calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.initialise.plane_pose import focal_length, pose
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.geometry.homography import homography
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]

CELLS = (6, 5)
"""Columns and rows of the cells in which the coverage of an image is counted."""
_USUAL_FOCAL = 3.0
"""Focal length in image widths where the views do not determine it yet."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewGeometry:
    """Position, size and tilt of the board in one image.

    Args:
        position: (u, v) of the middle of its marks as shares of the image, 0 to 1.
        size: square root of the share of the image that its marks enclose.
        tilt_deg: angle between line of sight and board normal, from foreshortening alone: no focal length enters.
        tilt_x_deg, tilt_y_deg: about the image's x axis (positive: lower edge further away) and y axis (positive:
            right edge further away); their signs come from perspective.
        turn: (2, 2) foreshortening relative to the best similarity, which distinguishes tilts without their signs.
        distance_mm: to the middle of the marks, with the focal length that was assumed.
        cells: (rows, columns) of :data:`CELLS` that hold marks.
        marks: count.
    """

    position: tuple[float, float]
    size: float
    tilt_deg: float
    tilt_x_deg: float
    tilt_y_deg: float
    turn: Array
    distance_mm: float
    cells: NDArray[np.bool_]
    marks: int


def view_geometries(
    board: Board,
    views: Sequence[BoardView],
    device: str,
    size: tuple[int, int],
    *,
    model: CameraModel | None = None,
    least_marks: int = 8,
) -> dict[int, ViewGeometry]:
    """View number -> geometry of the board in the device's image; views with too few marks are left out."""
    points = board.points
    marks = {
        k: view.marks[device] for k, view in enumerate(views)
        if device in view.marks and len(view.marks[device]) >= least_marks
    }  # fmt: skip
    maps = {k: homography(points[m.ids, :2], m.pixels)[0] for k, m in marks.items()}
    matrix = model.matrix if model is not None else _assumed(list(maps.values()), size)
    return {k: _view_geometry(points, marks[k], maps[k], matrix, size) for k in maps}


def _assumed(maps: list[Array], size: tuple[int, int]) -> Array:
    centre = (np.array(size, np.float64) - 1) / 2
    focal = focal_length(maps, centre) if len(maps) >= 3 else float("nan")
    if not 0.4 * size[0] < focal < 20 * size[0]:
        focal = _USUAL_FOCAL * size[0]
    return np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])


def _view_geometry(points: Array, marks: Marks, h: Array, matrix: Array, size: tuple[int, int]) -> ViewGeometry:
    middle = points[:, :2].mean(axis=0)
    affine, centre = _local(h, middle)
    u, s, _ = np.linalg.svd(affine)
    r, t = pose(h, matrix)
    at = r[:, :2] @ middle + t
    normal = _towards(at).T @ r[:, 2]
    share = marks.pixels / (np.array(size) - 1.0)
    column = np.clip((share[:, 0] * CELLS[0]).astype(int), 0, CELLS[0] - 1)
    row = np.clip((share[:, 1] * CELLS[1]).astype(int), 0, CELLS[1] - 1)
    cells = np.zeros(CELLS[::-1], dtype=bool)
    cells[row, column] = True
    extent = points[:, :2].max(axis=0) - points[:, :2].min(axis=0)
    area = abs(np.linalg.det(affine)) * extent[0] * extent[1] / (size[0] * size[1])
    return ViewGeometry(
        (float(centre[0] / (size[0] - 1)), float(centre[1] / (size[1] - 1))),
        float(np.sqrt(area)),
        float(np.degrees(np.arccos(np.clip(s[1] / s[0], 0, 1)))),
        float(np.degrees(np.arctan2(-normal[1], normal[2]))),
        float(np.degrees(np.arctan2(-normal[0], normal[2]))),
        u @ np.diag(s / s[0]) @ u.T,
        float(np.linalg.norm(at)),
        cells,
        len(marks),
    )


def _local(h: Array, at: Array) -> tuple[Array, Array]:
    """Derivative (2, 2) and value (2,) of a homography at a position on the board."""
    a = h @ np.array([at[0], at[1], 1.0])
    value = a[:2] / a[2]
    return (h[:2, :2] - np.outer(value, h[2, :2])) / a[2], value


def _towards(direction: Array) -> Array:
    """The least rotation that turns the z axis into a direction."""
    z = direction / np.linalg.norm(direction)
    axis = np.array([-z[1], z[0], 0.0])
    c = z[2]
    k = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + k + k @ k / (1 + c))


def pooled(per_device: Mapping[str, dict[int, ViewGeometry]]) -> dict[int, ViewGeometry]:
    """One geometry a view: the mean tilts over the devices that detected it, the rest from the first of them.

    The mean of left and right is about the geometry for a viewer between the cameras.
    """
    result: dict[int, ViewGeometry] = {}
    for view in sorted({view for geometries in per_device.values() for view in geometries}):
        pool = [geometries[view] for geometries in per_device.values() if view in geometries]
        first = pool[0]
        result[view] = ViewGeometry(
            first.position,
            first.size,
            max(geometry.tilt_deg for geometry in pool),
            float(np.mean([geometry.tilt_x_deg for geometry in pool])),
            float(np.mean([geometry.tilt_y_deg for geometry in pool])),
            first.turn,
            first.distance_mm,
            first.cells,
            first.marks,
        )
    return result
