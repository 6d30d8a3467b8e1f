"""Golden files: the expected points, coverage and grid of depths of every pair of a replay.

A golden file is JSON; users read it and edit its tolerances.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import InputError
from daemon.common.files import read_at_most, write_atomically

VERSION = 1
CELL = 32
MAX_BYTES = 256 << 20


class GoldenError(InputError):
    """An unusable golden file; the message names file and key."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Largest allowed deviations of a replay, stored in the golden file."""

    points_percent: float = 0.5
    """Change of the number of points of a pair."""
    coverage: float = 0.005
    """Change of the share of pixels with a point."""
    depth_mm: float = 0.05
    """Change of a cell's median depth."""
    spread_mm: float = 0.2
    """Change of the distance between a cell's quartiles of depth."""
    sigma_percent: float = 10.0
    """Change of a cell's median standard deviation, as a share of it."""
    count_percent: float = 10.0
    """Change of a cell's number of points, as a share of its pixels."""
    cells_percent: float = 0.5
    """Share of the cells that may exceed the four limits above."""
    min_count: int = 50
    """Least number of points, expected and actual, of a cell with a compared depth."""


@dataclass(frozen=True, slots=True)
class PairStatistics:
    """Figures of a cloud, row by row of the grid; None in cells without points.

    ``sigma_mm`` is None in files that were written before it was one of the figures: then it is not compared.
    """

    sequence: int
    size: tuple[int, int]
    points: int
    coverage: float
    median_mm: list[list[float | None]]
    spread_mm: list[list[float | None]]
    count: list[list[int]]
    sigma_mm: list[list[float | None]] | None = None


@dataclass(frozen=True, slots=True)
class Golden:
    """A golden file."""

    pairs: dict[int, PairStatistics]
    tolerances: Tolerances = field(default_factory=Tolerances)
    cell: int = CELL
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Deviation:
    """A deviation beyond the tolerance ``limit``."""

    sequence: int
    quantity: str
    expected: str
    actual: str
    limit: str


def statistics(
    sequence: int, depth_mm: NDArray[np.float32], sigma_mm: NDArray[np.float32], cell: int = CELL
) -> PairStatistics:
    """Compute the figures of a cloud.

    Args:
        depth_mm, sigma_mm: (H, W), NaN where invalid.
        cell: side of a square cell, pixels; cells at the border may be smaller.
    """
    height, width = depth_mm.shape
    medians: list[list[float | None]] = []
    spreads: list[list[float | None]] = []
    counts: list[list[int]] = []
    sigmas: list[list[float | None]] = []
    for top in range(0, height, cell):
        valid = [row[np.isfinite(row)] for row in _cells(depth_mm[top : top + cell], cell)]
        quartiles = [np.percentile(values, (25, 50, 75)) if values.size else None for values in valid]
        medians.append([None if q is None else round(float(q[1]), 4) for q in quartiles])
        spreads.append([None if q is None else round(float(q[2] - q[0]), 4) for q in quartiles])
        counts.append([int(values.size) for values in valid])
        known = [row[np.isfinite(row)] for row in _cells(sigma_mm[top : top + cell], cell)]
        sigmas.append([round(float(np.median(values)), 5) if values.size else None for values in known])
    points = int(np.isfinite(depth_mm).sum())
    coverage = round(points / depth_mm.size, 6)
    return PairStatistics(sequence, (width, height), points, coverage, medians, spreads, counts, sigmas)


def _cells(band: NDArray[np.float32], cell: int) -> list[NDArray[np.float32]]:
    return [band[:, left : left + cell].ravel() for left in range(0, band.shape[1], cell)]


def bless(path: Path, pairs: Sequence[PairStatistics], about: Mapping[str, Any]) -> Golden:
    """Write a golden file; tolerances and grid of a replaced file are kept.

    Args:
        about: origin of the figures, for users: take, calibration, settings.
    """
    before = load(path) if path.exists() else Golden({})
    golden = Golden({pair.sequence: pair for pair in pairs}, before.tolerances, before.cell, dict(about))
    head = {"fringed_golden": VERSION, "about": dict(about), "tolerances": asdict(golden.tolerances)}
    head["cell"] = golden.cell
    # One line for each pair keeps diffs readable and the file short.
    rows = ",\n  ".join(json.dumps(asdict(pair), separators=(", ", ": ")) for pair in pairs)
    text = json.dumps(head, indent=1).removesuffix("\n}") + f',\n "pairs": [\n  {rows}\n ]\n}}\n'
    write_atomically(path, text.encode())
    return golden


def load(path: Path) -> Golden:
    """Read a golden file.

    Raises:
        GoldenError: it is unusable; the message names the key.
    """
    data = read_at_most(path, MAX_BYTES, GoldenError)
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise GoldenError(f"{path}: not JSON: {error}; `--bless {path}` writes a new one") from error
    if not isinstance(value, dict) or value.get("fringed_golden") != VERSION:
        version = value.get("fringed_golden") if isinstance(value, dict) else None
        raise GoldenError(f"{path}: fringed_golden is {version!r}, this program reads version {VERSION}")
    try:
        pairs = [_pair(item) for item in value["pairs"]]
        cell = int(value["cell"])
        if not 1 <= cell <= 65535:
            raise ValueError(f"cell is {cell}, expected 1 to 65535 pixels")
        tolerances = _tolerances(value.get("tolerances", {}))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise GoldenError(f"{path}: {problem}") from error
    return Golden({pair.sequence: pair for pair in pairs}, tolerances, cell, value.get("about", {}))


def _pair(item: Mapping[str, Any]) -> PairStatistics:
    width, height = item["size"]
    return PairStatistics(
        int(item["sequence"]),
        (int(width), int(height)),
        int(item["points"]),
        float(item["coverage"]),
        item["median_mm"],
        item["spread_mm"],
        item["count"],
        item.get("sigma_mm"),
    )


def _tolerances(values: Mapping[str, Any]) -> Tolerances:
    known = {f.name for f in fields(Tolerances)}
    unknown = sorted(set(values) - known)
    if unknown:  # users edit these: a typing error must not be ignored
        raise ValueError(f"tolerances.{unknown[0]} is unknown; the tolerances are: {', '.join(sorted(known))}")
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
            raise ValueError(f"tolerances.{name} is {value!r}, expected a number from 0")
    return Tolerances(**values)
