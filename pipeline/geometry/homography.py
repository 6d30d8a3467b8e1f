"""Homographies from a plane to an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def homography(plane: Array, image: Array) -> tuple[Array, float]:
    """H (3, 3) with ``image ~ H (x, y, 1)``, positive scale on the points, and the median misfit in px.

    Normalised direct linear transform, reweighted so that single wrong points do not count.

    Args:
        plane: (n, 2), n at least 4; image: (n, 2) pixels.
    """
    to_plane, a = _normaliser(plane)
    to_image, b = _normaliser(image)
    row, zero, weight = np.column_stack([a, np.ones(len(a))]), np.zeros((len(a), 3)), np.ones(len(a))
    upper, lower = np.hstack([row, zero, -b[:, :1] * row]), np.hstack([zero, row, -b[:, 1:] * row])
    equations = np.concatenate([upper, lower])
    for _ in range(8):
        rows = equations * np.tile(weight, 2)[:, None]
        h = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
        mapped_points = row @ h.T
        if np.median(mapped_points[:, 2]) < 0:
            h, mapped_points = -h, -mapped_points
        with np.errstate(divide="ignore", invalid="ignore"):
            misfit = np.linalg.norm(mapped_points[:, :2] / mapped_points[:, 2:] - b, axis=1)
        misfit = np.where(np.isfinite(misfit), misfit, 1e6)
        scale = max(float(np.median(misfit)), 1e-12)
        weight = 1 / (1 + (misfit / (4 * scale)) ** 2) / np.maximum(np.abs(mapped_points[:, 2]), 1e-6)
    h = np.linalg.inv(to_image) @ h @ to_plane
    return h / np.linalg.norm(h), scale / float(to_image[0, 0])


def _normaliser(points: Array) -> tuple[Array, Array]:
    centre = points.mean(axis=0)
    size = max(float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean())), 1e-12)
    factor = np.sqrt(2) / size
    matrix = np.array([[factor, 0, -factor * centre[0]], [0, factor, -factor * centre[1]], [0, 0, 1]])
    return matrix, (points - centre) * factor


def mapped(matrix: Array, points: Array) -> Array:
    """Points (n, 2) through a homography."""
    ends = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(ends[:, :2] / ends[:, 2:])
