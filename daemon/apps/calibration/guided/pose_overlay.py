"""The board's outline in the left image at a requested pose."""

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
"""Part of the image's width that the board fills before the first view."""


def outline(board: Board, pose: Pose, size: tuple[int, int], *, distance_mm: float | None = None) -> Array:
    """Corners of the marks' rectangle, the first one repeated, (5, 2), px; with a usual focal length.

    Args:
        pose: the requested one. size: (width, height) of the image.
        distance_mm: usual distance so far (:mod:`pipeline.calibrate.bundle.quality.view_coverage`); None before the
            first view.
    """
    focal = USUAL_FOCAL * size[0]
    low, high = board.points.min(axis=0)[:2], board.points.max(axis=0)[:2]
    if distance_mm is None:
        distance_mm = float(focal * (high - low)[0] / (_USUAL_SHARE * size[0]))
    middle = (low + high) / 2
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]], [low[0], low[1]]])
    flat = np.column_stack([corners - middle, np.zeros(5)])
    centre = (np.array(size) - 1.0) / 2
    direction = np.append((np.array(pose.position) * (np.array(size) - 1.0) - centre) / focal, 1.0)
    at = direction / np.linalg.norm(direction) * distance_mm * pose.distance
    points = flat @ _rotation(pose, at).T + at
    return np.asarray(points[:, :2] / points[:, 2:] * focal + centre)


def within(corners: Array, size: tuple[int, int]) -> Array:
    """Move an outline into the image, and shrink it if necessary."""
    available = np.array(size) * (1 - 2 * _MARGIN)
    extent = np.ptp(corners, axis=0)
    middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
    smaller = middle + (corners - middle) * min(1.0, float((available / extent).min()))
    low, high = smaller.min(axis=0), smaller.max(axis=0)
    edge = np.array(size) * _MARGIN
    return np.asarray(smaller + np.maximum(edge - low, 0.0) - np.maximum(high - (np.array(size) - edge), 0.0))


def _rotation(pose: Pose, at: Array) -> Array:
    """Rotation from board to camera: tilted against the line of sight, its rows horizontal."""
    normal = np.array([-np.tan(np.radians(pose.tilt_y_deg)), -np.tan(np.radians(pose.tilt_x_deg)), 1.0])
    normal /= np.linalg.norm(normal)
    along = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    along /= np.linalg.norm(along)
    tilted = np.column_stack([along, np.cross(normal, along), normal])
    observation = at / np.linalg.norm(at)
    axis = np.cross([0.0, 0.0, 1.0], observation)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray((np.eye(3) + k + k @ k / (1 + observation[2])) @ tilted)
