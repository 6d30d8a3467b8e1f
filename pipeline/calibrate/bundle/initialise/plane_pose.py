"""Focal length and pose from plane-to-image homographies (Zhang, 2000)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
