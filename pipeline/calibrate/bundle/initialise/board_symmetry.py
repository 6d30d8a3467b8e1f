"""Symmetries of a board's grid: the renumberings that a detector may have confused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_MOTIONS: tuple[tuple[str, list[list[int]]], ...] = (
    ("as numbered", [[1, 0], [0, 1]]),
    ("turned by 180 degrees", [[-1, 0], [0, -1]]),
    ("turned by 90 degrees", [[0, -1], [1, 0]]),
    ("turned by 270 degrees", [[0, 1], [-1, 0]]),
    ("mirrored left to right", [[-1, 0], [0, 1]]),
    ("mirrored top to bottom", [[1, 0], [0, -1]]),
    ("mirrored at a diagonal", [[0, 1], [1, 0]]),
    ("mirrored at the other diagonal", [[0, -1], [-1, 0]]),
)


@dataclass(frozen=True, slots=True, eq=False)
class Symmetry:
    """A motion of the plane that maps the marks onto marks: ``points[permutation[m]] = rotation @ points[m] + shift``.

    Args:
        name: for messages.
        permutation: (n,) number of the mark at the new position of mark m.
        rotation: (3, 3), with determinant +1 also for mirror images (z is turned over then).
        shift: (3,) mm.
        mirrored: whether the motion turns the board over.
    """

    name: str
    permutation: Index
    rotation: Array
    shift: Array
    mirrored: bool


def symmetries(board: Board) -> list[Symmetry]:
    """All symmetries, the identity first; a ChArUco board has no other, because its markers number it."""
    points = board.points
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    out = []
    for name, plane in _MOTIONS if board.kind != "charuco" else _MOTIONS[:1]:
        mirrored = bool(np.linalg.det(plane) < 0)
        rotation = np.eye(3)
        rotation[:2, :2] = plane
        rotation[2, 2] = -1.0 if mirrored else 1.0
        moved = (points - middle) @ rotation.T + middle
        distance = np.linalg.norm(moved[:, None] - points[None], axis=-1)
        nearest = distance.argmin(axis=1)
        if distance.min(axis=1).max() < 1e-6 * board.pitch_mm:
            out.append(Symmetry(name, nearest.astype(np.int64), rotation, middle - rotation @ middle, mirrored))
    return out
