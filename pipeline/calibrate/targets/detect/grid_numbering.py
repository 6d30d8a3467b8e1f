"""Which mark of the board is which place of a lattice, and where the numbering begins.

The lattice of what was found is laid over the board's in its four rotations and all shifts; it is never mirrored. A
board that looks the same after a rotation (a grid of circles after half a turn) is numbered by a rule of the image,
so that two cameras that see it from about the same side agree: the rows run right, or down where they are upright; on
a square board, right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board

Array = NDArray[np.float64]
Places = NDArray[np.int64]

_TURN = np.array([[0, -1], [1, 0]])
_CLEAR_SHARE = 0.4
"""How much of one edge of the board must have been seen to tell it from the board moved by a row or column."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A numbering of lattice places.

    Args:
        ids: (n,) number of the mark, -1 where the board has none.
        hits: how many are not -1.
        rival: hits of the best numbering that means something else on the board.
    """

    ids: Places
    hits: int
    rival: int


def board_places(board: Board) -> Places:
    """(n, 2) lattice places a, b of the marks: along rows and columns; of asymmetric circles along the diagonals."""
    columns, rows = board.grid
    row, column = (index.ravel().astype(np.int64) for index in np.mgrid[0:rows, 0:columns])
    if board.kind != "acircles":
        return np.stack([column, row], axis=1)
    x, y = 2 * column + row % 2, row
    return np.stack([(x + y) // 2, (y - x) // 2], axis=1)


@lru_cache(maxsize=32)
def symmetries(board: Board) -> tuple[tuple[int, ...], ...]:
    """Numberings under which the board looks the same: mark k of the board becomes mark ``s[k]``; identity first.

    Whoever has several views may try them on a view that does not fit the others.
    """
    places = board_places(board)
    n = len(places)
    # A quarter turn puts the square at the upper right of a corner to its upper left, which has the other colour.
    colour = places.sum(axis=1) % 2 if board.kind == "chessboard" else None
    found = {tuple(range(n))}
    for turn in range(0 if board.kind == "charuco" else 4):
        turned = _turned(places, turn)
        for shift, hits in _shifts(turned, places)[:2]:
            if hits == n:
                ids = _ids(turned + shift, places)
                if colour is None or (colour[ids] == (colour + turn) % 2).all():
                    found.add(tuple(int(number) for number in ids))
    return tuple(sorted(found))


def match(places: Places, board: Board, *, mirrored: bool = False) -> Match:
    """The numbering with the most hits; among equal ones an arbitrary one, see :func:`oriented`.

    Args:
        places: (n, 2) of a lattice.
        board: what to find in it.
        mirrored: as if the board were seen in a mirror.
    """
    wanted = board_places(board)
    seen = places[:, ::-1] if mirrored else places
    trials = [
        (hits, turn, tuple(shift)) for turn in range(4) for shift, hits in _shifts(_turned(seen, turn), wanted)[:6]
    ]
    trials.sort(key=lambda trial: (-trial[0], trial[1:]))
    numbered = [(hits, _ids(_turned(seen, turn) + np.array(shift), wanted)) for hits, turn, shift in trials]
    best, ids = numbered[0]
    same = {tuple(_renumbered(ids, s)) for s in symmetries(board)}
    rival = max((hits for hits, other in numbered[1:] if tuple(other) not in same), default=0)
    return Match(ids, best, rival)


def clear(found: Match, board: Board) -> bool:
    """Whether enough was seen to exclude every other numbering."""
    if found.hits == len(board.points) and found.rival < found.hits:
        return True
    return found.hits - found.rival >= max(2, int(np.ceil(_CLEAR_SHARE * min(board.grid))))


def oriented(ids: Places, pixels: Array, board: Board, choices: Sequence[tuple[int, ...]] | None = None) -> Places:
    """Of the numberings that the board allows the one that obeys the rule of the image.

    Args:
        ids: (n,) numbers of marks.
        pixels: (n, 2) where they are.
        board: of any kind.
        choices: the numberings; None = :func:`symmetries`.
    """
    choices = symmetries(board) if choices is None else choices
    if len(choices) == 1:
        return _renumbered(ids, choices[0])
    wanted = np.array([1.0, 0.0]) if len(choices) == 4 else np.array([1.0, 1.0])
    best, score = ids, -np.inf
    for choice in choices:
        numbered = _renumbered(ids, choice)
        at = board.points[numbered, :2]
        basis = np.column_stack([at, np.ones(len(at))])
        right = np.linalg.lstsq(basis, pixels, rcond=None)[0][0]
        along = float(right @ wanted / np.linalg.norm(right))
        if along > score + 1e-9:
            best, score = numbered, along
    return best


def extent(places: Places, board: Board) -> tuple[int, int]:
    """Columns and rows of the full grid that was found, as the board's kind counts them; stray places cut off."""
    sizes = []
    if board.kind != "acircles":
        return _trimmed(places)
    for turn in range(4):
        a, b = _turned(places, turn).T
        x, y = a - b, a + b
        even = (y - y.min()) % 2 == 0
        rows = int(np.ptp(y)) + 1
        columns = int(np.median([np.sum(y == value) for value in np.unique(y)]))
        inside = (x[even].min() < x[~even].min()) if (~even).any() else True
        sizes.append((abs(columns * rows - len(places)), not inside, columns, rows))
    return min(sizes)[2:]


def _trimmed(places: Places) -> tuple[int, int]:
    current = places
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


def _turned(places: Places, turn: int) -> Places:
    return places @ np.linalg.matrix_power(_TURN, turn).T


def _shifts(places: Places, wanted: Places) -> list[tuple[Places, int]]:
    """Shifts that bring places onto wanted places, with the number of hits, most hits first."""
    low, high = places.min(axis=0), places.max(axis=0)
    least = wanted.min(axis=0) - high
    span = wanted.max(axis=0) - low - least + 1
    difference = (wanted[None] - places[:, None] - least).reshape(-1, 2)
    counts = np.bincount(difference[:, 0] * span[1] + difference[:, 1], minlength=int(span[0] * span[1]))
    order = np.argsort(-counts, kind="stable")[:8]
    return [(np.array([k // span[1], k % span[1]]) + least, int(counts[k])) for k in order]


def _ids(places: Places, wanted: Places) -> Places:
    """Number of the mark at each place, -1 where there is none."""
    low = wanted.min(axis=0)
    span = np.ptp(wanted, axis=0) + 1
    table = np.full(tuple(span), -1, dtype=np.int64)
    table[tuple((wanted - low).T)] = np.arange(len(wanted))
    inside = ((places >= low) & (places < low + span)).all(axis=1)
    ids = np.full(len(places), -1, dtype=np.int64)
    ids[inside] = table[tuple((places[inside] - low).T)]
    return ids


def _renumbered(ids: Places, choice: tuple[int, ...]) -> Places:
    return np.where(ids >= 0, np.array(choice)[ids], -1)
