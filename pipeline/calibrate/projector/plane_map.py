"""A smooth map of a plane into an image: a homography plus a cubic for the lens.

It needs no camera model. It describes what changes slowly over a board (slopes, the shift of a circle's centroid); the
positions of the marks are measured themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.homography import homography, mapped

F64: TypeAlias = NDArray[np.float64]

_CUBIC_FROM, _QUADRATIC_FROM = 30, 15
_STEP = 1e-4
_RINGS, _SPOKES = 4, 16


@dataclass(frozen=True, slots=True, eq=False)
class SmoothMap:
    """``map(points)`` takes (n, 2) to (n, 2).

    Args:
        matrix: (3, 3) homography; rest: (m, 2) coefficients of the polynomial in (points - origin) / scale.
    """

    matrix: F64
    rest: F64
    origin: F64
    scale: float

    @staticmethod
    def fitted(source: F64, target: F64, sigma: F64) -> SmoothMap:
        """Least squares through (n, 2) -> (n, 2), n of 4 or more; sigma (n,) of the targets.

        The polynomial is a cubic with 30 points or more, a quadratic with 15, none with fewer.
        """
        matrix, _ = homography(source, target)
        origin, scale = source.mean(axis=0), float(np.abs(source - source.mean(axis=0)).max())
        terms = 10 if len(source) >= _CUBIC_FROM else 6 if len(source) >= _QUADRATIC_FROM else 1
        design = _powers((source - origin) / scale)[:, :terms] / sigma[:, None]
        error = (target - mapped(matrix, source)) / sigma[:, None]
        return SmoothMap(matrix, np.asarray(np.linalg.lstsq(design, error, rcond=None)[0]), origin, scale)

    def __call__(self, points: F64) -> F64:
        """Images of points (..., 2)."""
        flat = points.reshape(-1, 2)
        powers = _powers((flat - self.origin) / self.scale)[:, : len(self.rest)]
        return np.asarray((mapped(self.matrix, flat) + powers @ self.rest).reshape(points.shape))

    def slope(self, points: F64) -> F64:
        """Jacobians, (..., 2) -> (..., 2, 2), rows: image, columns: plane."""
        step = _STEP * self.scale * np.eye(2)
        return np.stack([(self(points + d) - self(points - d)) / (2 * _STEP * self.scale) for d in step], axis=-1)

    def centroid_shift(self, points: F64, radius: float) -> F64:
        """Centroid of the image of a disc minus the image of its centre, (n, 2) -> (n, 2).

        The integral over the image is one over the disc, weighted by the map's local area.
        """
        rings = radius * np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)
        angles = 2 * np.pi * np.arange(_SPOKES) / _SPOKES
        spokes = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        inside = points[:, None] + (rings[:, None, None] * spokes).reshape(-1, 2)
        area = np.abs(np.linalg.det(self.slope(inside)))[..., None]
        return np.asarray((self(inside) * area).sum(axis=1) / area.sum(axis=1) - self(points))


def _powers(points: F64) -> F64:
    x, y = points.T
    one = np.ones_like(x)
    return np.stack([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=1)
