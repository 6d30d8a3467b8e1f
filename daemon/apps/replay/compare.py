"""Compare the figures of a replay with those of a golden file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.apps.replay.golden import Golden, GoldenError, Move, PairStatistics, Tolerances


def compare(golden: Golden, pairs: Sequence[PairStatistics]) -> list[Move]:
    """Everything that moved by more than the golden file's tolerances, in the order of the golden file."""
    now = {pair.sequence: pair for pair in pairs}
    moves: list[Move] = []
    for sequence, before in golden.pairs.items():
        if sequence not in now:
            moves.append(Move(sequence, "pair", "a cloud", "none", "must be there"))
        else:
            moves.extend(_pair(before, now[sequence], golden))
    moves.extend(Move(s, "pair", "none", "a cloud", "must be known") for s in now if s not in golden.pairs)
    return moves


def _pair(before: PairStatistics, now: PairStatistics, golden: Golden) -> Iterator[Move]:
    limits = golden.tolerances
    if before.size != now.size:
        yield Move(now.sequence, "size", _size(before), _size(now), "same")
        return
    allowed = before.points * limits.points_percent / 100
    if abs(now.points - before.points) > allowed:
        yield Move(now.sequence, "points", str(before.points), str(now.points), f"± {allowed:.0f}")
    if abs(now.coverage - before.coverage) > limits.coverage:
        yield Move(now.sequence, "coverage", f"{before.coverage:.4f}", f"{now.coverage:.4f}", f"± {limits.coverage:g}")
    yield from _cells(before, now, golden)


def _cells(before: PairStatistics, now: PairStatistics, golden: Golden) -> Iterator[Move]:
    """The three comparisons cell by cell; each tells how many moved and the worst of them."""
    limits, sequence = golden.tolerances, now.sequence
    pixels = _pixels(before.size, golden.cell)
    counts = _grid(before, "count", pixels.shape), _grid(now, "count", pixels.shape)
    rich = np.minimum(*counts) >= limits.min_count
    for name, limit in (("median_mm", limits.depth_mm), ("spread_mm", limits.spread_mm)):
        old, new = _grid(before, name, pixels.shape), _grid(now, name, pixels.shape)
        yield from _grid_move(sequence, name.removesuffix("_mm"), old, new, rich, limit, "mm", limits)
    old, new = (100 * count / pixels for count in counts)
    every = np.ones_like(rich)
    yield from _grid_move(sequence, "filled", old, new, every, limits.count_percent, "%", limits)


def _grid_move(
    sequence: int, name: str, old: Any, new: Any, compared: Any, limit: float, unit: str, limits: Tolerances
) -> Iterator[Move]:
    change = np.where(compared, np.abs(new - old), 0.0)
    moved = change > limit
    allowed = limits.cells_percent / 100 * max(1, int(np.count_nonzero(compared)))
    if np.count_nonzero(moved) <= allowed:
        return
    row, column = np.unravel_index(int(np.argmax(change)), change.shape)
    what = f"{name} of {np.count_nonzero(moved)} cells; worst: row {row}, column {column}"
    yield Move(
        sequence,
        what,
        f"{old[row, column]:.3f} {unit}",
        f"{new[row, column]:.3f} {unit}",
        f"± {limit:g} {unit}, {allowed:.0f} cells",
    )


def _grid(pair: PairStatistics, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """One of the grids as an array; GoldenError when it is not one of the golden file's cells."""
    try:
        grid = np.array(getattr(pair, name), dtype=np.float64)  # None becomes NaN
    except (TypeError, ValueError) as error:
        raise GoldenError(f"golden file, pair {pair.sequence}: {name} is damaged: {error}") from error
    if grid.shape != shape:
        raise GoldenError(
            f"golden file, pair {pair.sequence}: {name} has {grid.shape} cells, its cell size makes {shape}; bless anew"
        )
    return grid


def _pixels(size: tuple[int, int], cell: int) -> NDArray[np.float64]:
    """Pixels of every cell."""
    width, height = (np.diff(np.append(np.arange(0, n, cell), n)) for n in size)
    return np.outer(height, width).astype(np.float64)


def _size(pair: PairStatistics) -> str:
    return f"{pair.size[0]} x {pair.size[1]}"
