"""Compare the figures of a replay with those of a golden file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.apps.replay.golden import Deviation, Golden, GoldenError, PairStatistics, Tolerances


def compare(golden: Golden, pairs: Sequence[PairStatistics]) -> list[Deviation]:
    """All deviations beyond the golden file's tolerances, in the order of the golden file."""
    now = {pair.sequence: pair for pair in pairs}
    deviations: list[Deviation] = []
    for sequence, before in golden.pairs.items():
        if sequence not in now:
            deviations.append(Deviation(sequence, "pair", "a cloud", "none", "must exist"))
        else:
            deviations.extend(_pair(before, now[sequence], golden))
    deviations.extend(Deviation(s, "pair", "none", "a cloud", "must not exist") for s in now if s not in golden.pairs)
    return deviations


def _pair(before: PairStatistics, now: PairStatistics, golden: Golden) -> Iterator[Deviation]:
    limits = golden.tolerances
    if before.size != now.size:
        yield Deviation(now.sequence, "size", _size(before), _size(now), "same")
        return
    allowed = before.points * limits.points_percent / 100
    if abs(now.points - before.points) > allowed:
        yield Deviation(now.sequence, "points", str(before.points), str(now.points), f"± {allowed:.0f}")
    if abs(now.coverage - before.coverage) > limits.coverage:
        yield Deviation(
            now.sequence, "coverage", f"{before.coverage:.4f}", f"{now.coverage:.4f}", f"± {limits.coverage:g}"
        )
    yield from _cells(before, now, golden)


def _cells(before: PairStatistics, now: PairStatistics, golden: Golden) -> Iterator[Deviation]:
    """Compare the grids cell by cell; a deviation states the number of deviating cells and the worst one."""
    limits, sequence = golden.tolerances, now.sequence
    pixels = _pixels(before.size, golden.cell)
    counts = [_grid(pair.sequence, "count", pair.count, pixels.shape) for pair in (before, now)]
    dense = np.minimum(*counts) >= limits.min_count
    for name, grids, limit in (
        ("median", (before.median_mm, now.median_mm), limits.depth_mm),
        ("spread", (before.spread_mm, now.spread_mm), limits.spread_mm),
    ):
        old, new = (_grid(sequence, f"{name}_mm", grid, pixels.shape) for grid in grids)
        yield from _grid_deviation(sequence, name, old, new, dense, limit, "mm", limits)
    if before.sigma_mm is not None:
        old, new = (_grid(sequence, "sigma_mm", pair.sigma_mm, pixels.shape) for pair in (before, now))
        most = limits.sigma_percent / 100 * np.nan_to_num(old)
        yield from _grid_deviation(sequence, "sigma", old, new, dense, most, "mm", limits)
    old, new = (100 * count / pixels for count in counts)
    every = np.ones_like(dense)
    yield from _grid_deviation(sequence, "filled", old, new, every, limits.count_percent, "%", limits)


def _grid_deviation(
    sequence: int, name: str, old: Any, new: Any, compared: Any, limit: Any, unit: str, limits: Tolerances
) -> Iterator[Deviation]:
    """Compare a grid; ``limit`` is a number or one for each cell. A value that only one of both has exceeds it."""
    change = np.where(compared, np.nan_to_num(np.abs(new - old)), 0.0)
    change[compared & (np.isnan(new) != np.isnan(old))] = np.inf
    exceeded = change > limit
    allowed = limits.cells_percent / 100 * max(1, int(np.count_nonzero(compared)))
    if np.count_nonzero(exceeded) <= allowed:
        return
    row, column = np.unravel_index(int(np.argmax(change)), change.shape)
    quantity = f"{name} of {np.count_nonzero(exceeded)} cells; worst: row {row}, column {column}"
    yield Deviation(
        sequence,
        quantity,
        f"{old[row, column]:.3f} {unit}",
        f"{new[row, column]:.3f} {unit}",
        f"± {np.broadcast_to(limit, change.shape)[row, column]:.3g} {unit}, {allowed:.0f} cells",
    )


def _grid(sequence: int, name: str, values: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Convert a grid to an array; GoldenError if its shape does not match the golden file's cell size."""
    try:
        grid = np.array(values, dtype=np.float64)  # None becomes NaN
    except (TypeError, ValueError) as error:
        raise GoldenError(f"golden file, pair {sequence}: {name} is invalid: {error}") from error
    if grid.shape != shape:
        raise GoldenError(
            f"golden file, pair {sequence}: {name} has {grid.shape} cells, its cell size gives {shape}; write it "
            "again with --bless"
        )
    return grid


def _pixels(size: tuple[int, int], cell: int) -> NDArray[np.float64]:
    """Number of pixels of every cell."""
    width, height = (np.diff(np.append(np.arange(0, n, cell), n)) for n in size)
    return np.outer(height, width).astype(np.float64)


def _size(pair: PairStatistics) -> str:
    return f"{pair.size[0]} x {pair.size[1]}"
