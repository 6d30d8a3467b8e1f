"""Marks of a board localised in one device's image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Marks localised in one image, in any order; for a projector, its own pixels that light the marks.

    Args:
        ids: (n,) numbers of the marks, see :class:`pipeline.calibrate.targets.board.board.Board`; none twice.
        pixels: (n, 2) u, v. For circles this is the centroid of the circle's image, not the image of its centre.
        sigma_px: (n,) expected standard deviation of each coordinate from the image's noise.
        areas_px: (n,) areas of the circles' images where ``pixels`` are their centroids, which a model must then
            predict as centroids; None where they are images of points (corners; a projector's marks).
    """

    ids: NDArray[np.int64]
    pixels: Array
    sigma_px: Array
    areas_px: Array | None = None

    def __post_init__(self) -> None:
        n = len(self.ids)
        if self.ids.shape != (n,) or self.pixels.shape != (n, 2) or self.sigma_px.shape != (n,):
            raise ValueError(
                f"marks: ids {self.ids.shape}, pixels {self.pixels.shape}, sigma_px {self.sigma_px.shape} do not agree"
            )
        if self.areas_px is not None and self.areas_px.shape != (n,):
            raise ValueError(f"marks: areas_px {self.areas_px.shape}, expected {(n,)}")
        if len(np.unique(self.ids)) != n:
            raise ValueError("marks: a number occurs twice")

    def __len__(self) -> int:
        return len(self.ids)

    def some(self, chosen: NDArray[np.bool_]) -> Marks:
        """The marks where ``chosen`` (n,) is true."""
        areas = None if self.areas_px is None else self.areas_px[chosen]
        return Marks(self.ids[chosen], self.pixels[chosen], self.sigma_px[chosen], areas)


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Marks of one board pose in some of the devices ``left``, ``right``, ``projector``."""

    name: str
    marks: dict[str, Marks]
