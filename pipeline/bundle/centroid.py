"""Where the centroid of a circle's image lies, relative to the image of its centre.

Under perspective the image of a circle is (nearly) an ellipse whose centre is not the image of the circle's centre,
and distortion moves the centroid further (Heikkila, 2000).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.bundle.observations import Observations
from pipeline.bundle.projection import image, image_with_slopes
from pipeline.bundle.state import State

Array = NDArray[np.float64]

_ANGLES = 2 * np.pi * np.arange(8) / 8
_NODES, _SHARES = np.polynomial.legendre.leggauss(3)


def offsets(state: State, data: Observations, diameter_mm: float) -> Array:
    """Centroid of the circle's image minus image of its centre, (n, 2) px; zero for marks that are points.

    The centroid is the integral of the image point over the circle, weighted with the area that each bit of the
    circle has in the picture, by Gauss quadrature in radius and equal angles: exact for the whole model.
    """
    result = np.zeros((len(data), 2))
    chosen = np.isfinite(data.area)
    if diameter_mm <= 0 or not chosen.any():
        return result
    some = data.some(chosen)
    centroid, _, centre = _moments(state, some, diameter_mm / 2)
    result[chosen] = centroid - centre
    return result


def areas(state: State, data: Observations, diameter_mm: float) -> Array:
    """Areas of the circles' images, (n,) px^2."""
    return _moments(state, data, diameter_mm / 2)[1]


def diameter_mm(state: State, data: Observations) -> float:
    """The diameter that explains the measured areas best (median over the marks); 0 without areas."""
    some = data.some(np.isfinite(data.area) & (np.nan_to_num(data.area) > 0))
    if not len(some):
        return 0.0
    return float(np.median(np.sqrt(some.area / areas(state, some, 1.0))))


def _moments(state: State, data: Observations, radius: float) -> tuple[Array, Array, Array]:
    intrinsics = state.intrinsics[data.device]
    rotation = state.rotations[data.device] @ state.view_rotations[data.view]
    world = np.einsum("nij,nj->ni", state.view_rotations[data.view], state.points[data.mark])
    world += state.view_translations[data.view]
    centre = np.einsum("nij,nj->ni", state.rotations[data.device], world) + state.translations[data.device]
    total, first = np.zeros(len(data)), np.zeros((len(data), 2))
    for node, share in zip((_NODES + 1) / 2, _SHARES / 2, strict=True):
        for angle in _ANGLES:
            along = radius * np.sqrt(node) * np.array([np.cos(angle), np.sin(angle)])
            pixels, _, of_point = image_with_slopes(intrinsics, centre + rotation[:, :, :2] @ along)
            in_plane = of_point @ rotation[:, :, :2]
            area = share / len(_ANGLES) * np.pi * radius**2 * np.abs(np.linalg.det(in_plane))
            total += area
            first += area[:, None] * pixels
    return first / total[:, None], total, image(intrinsics, centre)
