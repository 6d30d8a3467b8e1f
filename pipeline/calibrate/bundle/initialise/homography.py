"""Plane-to-image homographies, and focal length and pose from them (Zhang, 2000)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def homography(board: Array, pixels: Array) -> tuple[Array, float]:
    """H (3, 3) with ``pixels ~ H (x, y, 1)``, positive scale on the marks, and the median misfit in px.

    Normalised direct linear transform, reweighted so that single wrong marks do not count.

    Args:
        board: (n, 2) mm, n at least 4.
        pixels: (n, 2).
    """
    to_board, a = _normaliser(board)
    to_pixels, b = _normaliser(pixels)
    weight = np.ones(len(a))
    for _ in range(8):
        one, zero = np.ones(len(a)), np.zeros((len(a), 3))
        row = np.column_stack([a, one])
        upper = np.concatenate([row, zero, -b[:, :1] * row], axis=1) * weight[:, None]
        lower = np.concatenate([zero, row, -b[:, 1:] * row], axis=1) * weight[:, None]
        rows = np.concatenate([upper, lower])
        h = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
        seen = row @ h.T
        if np.median(seen[:, 2]) < 0:
            h, seen = -h, -seen
        with np.errstate(divide="ignore", invalid="ignore"):
            misfit = np.linalg.norm(seen[:, :2] / seen[:, 2:] - b, axis=1)
        misfit = np.where(np.isfinite(misfit), misfit, 1e6)
        scale = max(float(np.median(misfit)), 1e-12)
        weight = 1 / (1 + (misfit / (4 * scale)) ** 2) / np.maximum(np.abs(seen[:, 2]), 1e-6)
    h = np.linalg.inv(to_pixels) @ h @ to_board
    return h / np.linalg.norm(h), scale / float(to_pixels[0, 0])


def _normaliser(points: Array) -> tuple[Array, Array]:
    centre = points.mean(axis=0)
    size = max(float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean())), 1e-12)
    factor = np.sqrt(2) / size
    matrix = np.array([[factor, 0, -factor * centre[0]], [0, factor, -factor * centre[1]], [0, 0, 1]])
    return matrix, (points - centre) * factor


def focal_length(homographies: list[Array], centre: Array) -> float:
    """Focal length, px, of square pixels with the principal point at ``centre``; NaN if not determined."""
    rows, right = [], []
    move = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1.0]])
    for h in homographies:
        g = move @ h
        g = g / np.linalg.norm(g[:2, :2])
        # Columns 1 and 2 of the rotation are orthogonal and equally long.
        rows += [g[0, 0] * g[0, 1] + g[1, 0] * g[1, 1], (g[:2, 0] ** 2).sum() - (g[:2, 1] ** 2).sum()]
        right += [-g[2, 0] * g[2, 1], -(g[2, 0] ** 2 - g[2, 1] ** 2)]
    a, b = np.array(rows), np.array(right)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = float((a @ a) / (a @ b))
    return float(np.sqrt(square)) if np.isfinite(square) and square > 0 else float("nan")


def pose(h: Array, matrix: Array) -> tuple[Array, Array]:
    """(R, t), board to device, of a homography and an intrinsic matrix."""
    g = np.linalg.solve(matrix, h)
    g = g / np.sqrt(np.linalg.norm(g[:, 0]) * np.linalg.norm(g[:, 1]))
    if g[2, 2] < 0:
        g = -g
    u, _, vt = np.linalg.svd(np.column_stack([g[:, 0], g[:, 1], np.cross(g[:, 0], g[:, 1])]))
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt), g[:, 2]


def shows_front(h: Array) -> bool:
    """Whether the board's printed side faces the device; otherwise image or numbering are mirrored."""
    return bool(np.linalg.det(h) > 0)
