"""All marks of all views in flat arrays, sorted by view and device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView
from pipeline.common.errors import CalibrationError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAST_SIGMA_PX = 1e-3
"""Lower bound of a mark's standard deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """n marks detected by the devices.

    Args:
        device, view, mark: (n,) numbers; ``mark`` is the index on the board, ``ids`` the number in the user's marks
            (different where a view's numbering was repaired).
        pixels: (n, 2).
        sigma: (n,) standard deviation of a coordinate, px.
        area: (n,) px^2; NaN where the mark is the image of a point.
        ids: (n,).
    """

    device: Index
    view: Index
    mark: Index
    pixels: Array
    sigma: Array
    area: Array
    ids: Index

    def __len__(self) -> int:
        return len(self.device)

    def some(self, chosen: NDArray[np.bool_]) -> Observations:
        """The marks where ``chosen`` (n,) is true."""
        return Observations(
            self.device[chosen],
            self.view[chosen],
            self.mark[chosen],
            self.pixels[chosen],
            self.sigma[chosen],
            self.area[chosen],
            self.ids[chosen],
        )

    def of(self, device: int, view: int | None = None) -> Observations:
        """The marks of one device (in one view)."""
        chosen = self.device == device
        return self.some(chosen if view is None else chosen & (self.view == view))

    def groups(self) -> list[tuple[int, int, slice]]:
        """(device, view, where) of every image that has marks."""
        if not len(self):
            return []
        key = self.view * 64 + self.device
        begins = np.flatnonzero(np.diff(key, prepend=key[0] - 1))
        ends = [*begins[1:].tolist(), len(key)]
        return [
            (int(self.device[b]), int(self.view[b]), slice(int(b), int(e))) for b, e in zip(begins, ends, strict=True)
        ]

    def with_sigma(self, sigma: Array) -> Observations:
        """The same marks with other standard deviations, (n,)."""
        return replace(self, sigma=sigma)

    def renumbered(self, device: int, view: int, permutation: Index) -> Observations:
        """Mark m of that image becomes mark ``permutation[m]``."""
        chosen = (self.device == device) & (self.view == view)
        return replace(self, mark=np.where(chosen, permutation[self.mark], self.mark))


def gather(board: Board, views: Sequence[BoardView], devices: Sequence[str]) -> Observations:
    """Flat arrays of all marks of the named devices.

    Raises:
        CalibrationError: a mark's number is not on the board, or a number is not finite.
    """
    count = len(board.points)
    rows: list[tuple[NDArray[Any], ...]] = []
    for number, view in enumerate(views):
        for device, name in enumerate(devices):
            marks = view.marks.get(name)
            if marks is None or not len(marks):
                continue
            if marks.ids.min() < 0 or marks.ids.max() >= count:
                raise CalibrationError(
                    f"view {view.name}, {name}: mark {int(marks.ids.max())} is not on the board {board}, which has "
                    f"{count} marks; give the board that was shown"
                )
            if not (
                np.isfinite(marks.pixels).all() and (marks.sigma_px >= 0).all() and np.isfinite(marks.sigma_px).all()
            ):
                raise CalibrationError(f"view {view.name}, {name}: a mark's pixels or sigma_px are not finite")
            order = np.argsort(marks.ids)
            n = len(marks)
            area = np.full(n, np.nan) if marks.areas_px is None else marks.areas_px[order]
            rows.append(
                (np.full(n, device), np.full(n, number), marks.ids[order], marks.pixels[order],
                 np.maximum(marks.sigma_px[order], LEAST_SIGMA_PX), area)
            )  # fmt: skip
    if not rows:
        raise CalibrationError(f"no view holds marks of {', '.join(devices)}; detect the board's marks first")
    device_, view_, mark, pixels, sigma, area_ = (np.concatenate(column) for column in zip(*rows, strict=True))
    ids = mark.astype(np.int64)
    return Observations(
        device_.astype(np.int64), view_.astype(np.int64), ids, pixels, sigma.astype(np.float64), area_, ids
    )
