"""Marks of a board that were located in one device's picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Marks found in one picture, in any order; for a projector, where its own picture meets the marks.

    Args:
        ids: (n,) numbers of the marks, see :class:`pipeline.targets.board.Board`; none twice.
        pixels: (n, 2) u, v. For circles this is the centroid of the circle's image, not the image of its centre.
        sigma_px: (n,) expected standard deviation of each coordinate from the picture's noise.
        area: whether the pixels are centroids of areas (circles seen by a camera), so that whoever fits a model must
            predict centroids, or images of points (corners; a projector's marks).
    """

    ids: NDArray[np.int64]
    pixels: Array
    sigma_px: Array
    area: bool = False

    def __post_init__(self) -> None:
        n = len(self.ids)
        if self.ids.shape != (n,) or self.pixels.shape != (n, 2) or self.sigma_px.shape != (n,):
            raise ValueError(
                f"marks: ids {self.ids.shape}, pixels {self.pixels.shape}, sigma_px {self.sigma_px.shape} do not agree"
            )
        if len(np.unique(self.ids)) != n:
            raise ValueError("marks: a mark is there twice")

    def __len__(self) -> int:
        return len(self.ids)

    def some(self, chosen: NDArray[np.bool_]) -> Marks:
        """The marks where ``chosen`` (n,) is true."""
        return Marks(self.ids[chosen], self.pixels[chosen], self.sigma_px[chosen], self.area)


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """One place of the board, seen by some of the devices ``left``, ``right``, ``projector``."""

    name: str
    marks: dict[str, Marks]
