"""Where the board's outline would be in the left image at a pose that is wished for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.quality.view_assessment import Pose
from pipeline.calibrate.targets.board.board import Board

Array = NDArray[np.float64]

USUAL_FOCAL = 3.0
"""Focal length in image widths; :mod:`pipeline.calibrate.bundle.quality.view_coverage` assumes it for a single view."""
_MARGIN = 0.03
_USUAL_SHARE = 0.6
"""Part of the image's width that the board fills where nothing is known yet."""


def outline(board: Board, pose: Pose, size: tuple[int, int], *, distance_mm: float | None = None) -> Array:
    """Corners of the marks' rectangle, first one again at the end, (5, 2), px; with a usual focal length.

    Args:
        pose: wished for. size: (width, height) of the image.
        distance_mm: usual distance so far, as :mod:`pipeline.calibrate.bundle.quality.view_coverage` tells it; None =
            nothing was seen yet.
    """
    focal = USUAL_FOCAL * size[0]
    low, high = board.points.min(axis=0)[:2], board.points.max(axis=0)[:2]
    if distance_mm is None:
        distance_mm = float(focal * (high - low)[0] / (_USUAL_SHARE * size[0]))
    middle = (low + high) / 2
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]], [low[0], low[1]]])
    flat = np.column_stack([corners - middle, np.zeros(5)])
    centre = (np.array(size) - 1.0) / 2
    seen = np.append((np.array(pose.position) * (np.array(size) - 1.0) - centre) / focal, 1.0)
    at = seen / np.linalg.norm(seen) * distance_mm * pose.distance
    points = flat @ _turned(pose, at).T + at
    return np.asarray(points[:, :2] / points[:, 2:] * focal + centre)


def within(corners: Array, size: tuple[int, int]) -> Array:
    """An outline moved, and made smaller where that is not enough, until all of it is in the image."""
    room = np.array(size) * (1 - 2 * _MARGIN)
    extent = np.ptp(corners, axis=0)
    middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
    smaller = middle + (corners - middle) * min(1.0, float((room / extent).min()))
    low, high = smaller.min(axis=0), smaller.max(axis=0)
    edge = np.array(size) * _MARGIN
    return np.asarray(smaller + np.maximum(edge - low, 0.0) - np.maximum(high - (np.array(size) - edge), 0.0))


def _turned(pose: Pose, at: Array) -> Array:
    """Board to camera: tilted as told against the line of sight, its rows level."""
    normal = np.array([-np.tan(np.radians(pose.tilt_y_deg)), -np.tan(np.radians(pose.tilt_x_deg)), 1.0])
    normal /= np.linalg.norm(normal)
    along = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    along /= np.linalg.norm(along)
    tilted = np.column_stack([along, np.cross(normal, along), normal])
    sight = at / np.linalg.norm(at)
    axis = np.cross([0.0, 0.0, 1.0], sight)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray((np.eye(3) + k + k @ k / (1 + sight[2])) @ tilted)
