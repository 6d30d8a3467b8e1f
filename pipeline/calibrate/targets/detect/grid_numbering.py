"""Numbering of detected lattice positions by the marks of the board.

The detected lattice is matched with the board's in its four rotations and all shifts; it is never mirrored. A board
that is symmetric under a rotation (a grid of circles under half a turn) is numbered by its orientation in the image,
so that two cameras on about the same side agree: the rows run right, or down where they are upright; on a square
board, right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board

Array = NDArray[np.float64]
Positions = NDArray[np.int64]

_QUARTER_TURN = np.array([[0, -1], [1, 0]])
_CLEAR_SHARE = 0.4
"""Share of one edge of the board that must be detected to exclude a shift by a row or column."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A numbering of lattice positions.

    Args:
        ids: (n,) number of the mark, -1 where the board has none.
        hits: how many are not -1.
        runner_up_hits: hits of the best numbering that is not equivalent on the board.
    """

    ids: Positions
    hits: int
    runner_up_hits: int


def board_positions(board: Board) -> Positions:
    """(n, 2) lattice positions a, b of the marks: along rows and columns; of asymmetric circles along the diagonals."""
    columns, rows = board.grid
    row, column = (index.ravel().astype(np.int64) for index in np.mgrid[0:rows, 0:columns])
    if board.kind != "acircles":
        return np.stack([column, row], axis=1)
    x, y = 2 * column + row % 2, row
    return np.stack([(x + y) // 2, (y - x) // 2], axis=1)


@lru_cache(maxsize=32)
def symmetries(board: Board) -> tuple[tuple[int, ...], ...]:
    """Symmetries of the board as renumberings: mark k of the board becomes mark ``s[k]``; identity first.

    With several views they can be tried on a view that does not fit the others.
    """
    positions = board_positions(board)
    n = len(positions)
    # A quarter turn puts the square at the upper right of a corner to its upper left, which has the other colour.
    colour = positions.sum(axis=1) % 2 if board.kind == "chessboard" else None
    numberings = {tuple(range(n))}
    for quarter_turns in range(0 if board.kind == "charuco" else 4):
        rotated = _rotated(positions, quarter_turns)
        for shift, hits in _shifts(rotated, positions)[:2]:
            if hits == n:
                ids = _ids(rotated + shift, positions)
                if colour is None or (colour[ids] == (colour + quarter_turns) % 2).all():
                    numberings.add(tuple(int(number) for number in ids))
    return tuple(sorted(numberings))


def match(positions: Positions, board: Board, *, mirrored: bool = False) -> Match:
    """The numbering with the most hits; among equal ones an arbitrary one, see :func:`oriented`.

    Args:
        positions: (n, 2) of a lattice.
        board: what to find in it.
        mirrored: match the mirror image.
    """
    targets = board_positions(board)
    detected = positions[:, ::-1] if mirrored else positions
    rotations = [_rotated(detected, turns) for turns in range(4)]
    trials = [
        (hits, turns, tuple(shift))
        for turns, rotated in enumerate(rotations)
        for shift, hits in _shifts(rotated, targets)[:6]
    ]
    trials.sort(key=lambda trial: (-trial[0], trial[1:]))
    numbered = [(hits, _ids(rotations[turns] + np.array(shift), targets)) for hits, turns, shift in trials]
    best, ids = numbered[0]
    same = {tuple(_renumbered(ids, s)) for s in symmetries(board)}
    runner_up_hits = max((hits for hits, other in numbered[1:] if tuple(other) not in same), default=0)
    return Match(ids, best, runner_up_hits)


def clear(numbering: Match, board: Board) -> bool:
    """Whether enough marks are detected to exclude every other numbering."""
    if numbering.hits == len(board.points) and numbering.runner_up_hits < numbering.hits:
        return True
    return numbering.hits - numbering.runner_up_hits >= max(2, int(np.ceil(_CLEAR_SHARE * min(board.grid))))


def oriented(
    ids: Positions, pixels: Array, board: Board, choices: Sequence[tuple[int, ...]] | None = None
) -> Positions:
    """The symmetric numbering whose rows run right in the image, or down where they are upright.

    Args:
        ids: (n,) numbers of marks.
        pixels: (n, 2) where they are.
        board: of any kind.
        choices: the numberings; None = :func:`symmetries`.
    """
    choices = symmetries(board) if choices is None else choices
    if len(choices) == 1:
        return _renumbered(ids, choices[0])
    axis = np.array([1.0, 0.0]) if len(choices) == 4 else np.array([1.0, 1.0])
    best, score = ids, -np.inf
    for choice in choices:
        numbered = _renumbered(ids, choice)
        at = board.points[numbered, :2]
        basis = np.column_stack([at, np.ones(len(at))])
        right = np.linalg.lstsq(basis, pixels, rcond=None)[0][0]
        along = float(right @ axis / np.linalg.norm(right))
        if along > score + 1e-9:
            best, score = numbered, along
    return best


def extent(positions: Positions, board: Board) -> tuple[int, int]:
    """Columns and rows of the detected grid, as the board's kind counts them, without stray positions."""
    sizes = []
    if board.kind != "acircles":
        return _trimmed(positions)
    for quarter_turns in range(4):
        a, b = _rotated(positions, quarter_turns).T
        x, y = a - b, a + b
        even = (y - y.min()) % 2 == 0
        rows = int(np.ptp(y)) + 1
        columns = int(np.median([np.sum(y == value) for value in np.unique(y)]))
        inside = (x[even].min() < x[~even].min()) if (~even).any() else True
        sizes.append((abs(columns * rows - len(positions)), not inside, columns, rows))
    return min(sizes)[2:]


def _trimmed(positions: Positions) -> tuple[int, int]:
    current = positions
    while True:
        size = len(current)
        for axis in (0, 1):
            counts = np.bincount(current[:, axis] - current[:, axis].min())
            for end, value in ((0, current[:, axis].min()), (-1, current[:, axis].max())):
                if counts[end] < 0.5 * counts.max():
                    current = current[current[:, axis] != value]
                    break
        if len(current) == size:
            span = np.ptp(current, axis=0) + 1
            return int(span.max()), int(span.min())


def _rotated(positions: Positions, quarter_turns: int) -> Positions:
    return positions @ np.linalg.matrix_power(_QUARTER_TURN, quarter_turns).T


def _shifts(positions: Positions, targets: Positions) -> list[tuple[Positions, int]]:
    """Shifts that move positions onto targets, with the number of hits, most hits first."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    least = targets.min(axis=0) - high
    span = targets.max(axis=0) - low - least + 1
    difference = (targets[None] - positions[:, None] - least).reshape(-1, 2)
    counts = np.bincount(difference[:, 0] * span[1] + difference[:, 1], minlength=int(span[0] * span[1]))
    order = np.argsort(-counts, kind="stable")[:8]
    return [(np.array([k // span[1], k % span[1]]) + least, int(counts[k])) for k in order]


def _ids(positions: Positions, targets: Positions) -> Positions:
    """Number of the mark at each position, -1 where there is none."""
    low = targets.min(axis=0)
    span = np.ptp(targets, axis=0) + 1
    table = np.full(tuple(span), -1, dtype=np.int64)
    table[tuple((targets - low).T)] = np.arange(len(targets))
    inside = ((positions >= low) & (positions < low + span)).all(axis=1)
    ids = np.full(len(positions), -1, dtype=np.int64)
    ids[inside] = table[tuple((positions[inside] - low).T)]
    return ids


def _renumbered(ids: Positions, choice: tuple[int, ...]) -> Positions:
    return np.where(ids >= 0, np.array(choice)[ids], -1)
