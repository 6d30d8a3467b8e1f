"""Rows of a file of points: columns of the grid, valid points only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Column = tuple[str, str, NDArray[Any]]
"""Name, type and plane (...) of a column."""


def positions(xyz: NDArray[np.float32]) -> list[Column]:
    """The columns x, y and z of (..., 3) points."""
    return [(name, "<f4", xyz[..., axis]) for axis, name in enumerate("xyz")]


def directions(names: str, normals: NDArray[np.float32] | None) -> list[Column]:
    """The columns of (..., 3) normals, 0 0 0 where unknown; ``names`` with ``{}`` for the axis. None: no column."""
    if normals is None:
        return []
    return [(names.format(name), "<f4", np.nan_to_num(normals[..., axis])) for axis, name in enumerate("xyz")]


def quality(sigma: NDArray[np.float32] | None, interpolated: NDArray[Any] | None) -> list[Column]:
    """The columns ``sigma`` and ``interpolated``, those that there are."""
    columns: list[Column] = [] if sigma is None else [("sigma", "<f4", sigma)]
    return columns if interpolated is None else [*columns, ("interpolated", "|u1", interpolated)]


def point_rows(xyz: NDArray[np.float32], columns: list[Column]) -> NDArray[Any]:
    """The valid points as a structured array of the columns; points that are not finite are left out."""
    valid = np.isfinite(xyz).all(axis=-1)
    rows: NDArray[Any] = np.empty(int(valid.sum()), np.dtype([(name, kind) for name, kind, _ in columns]))
    for name, _, plane in columns:
        rows[name] = plane[valid]
    return rows
