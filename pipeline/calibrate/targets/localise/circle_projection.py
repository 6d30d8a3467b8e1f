"""Centroid and area of a printed circle's image under the full camera model.

The image of a circle's centre is not the centroid of the circle's image: perspective makes the near half larger
(the centre of an ellipse is not the image of the centre), and a lens's distortion moves it once more. Both follow from
one integral over the disc, ``centroid = int u |J| dA / int |J| dA``, where J is the determinant of the map from the
board to the image. The integrand is smooth on the scale of a disc, so a cubature of degree seven
(Stroud, 1971, S2 7-1) is exact to far below a thousandth of a pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.camera_model import CameraModel, distortion_slopes

Array = NDArray[np.float64]

_STEPS = 3


def _cubature() -> tuple[Array, Array]:
    """Nodes (12, 2) in the unit disc and weights (12,) of sum 1: exact for all polynomials of degree 7."""
    r, s, t = np.sqrt(3 / 4), np.sqrt((27 - 3 * np.sqrt(29)) / 104), np.sqrt((27 + 3 * np.sqrt(29)) / 104)
    near, far = (551 + 41 * np.sqrt(29)) / 6264, (551 - 41 * np.sqrt(29)) / 6264
    axes = np.array([[r, 0], [-r, 0], [0, r], [0, -r]])
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    return np.concatenate([axes, s * signs, t * signs]), np.repeat([2 / 27, near, far], 4)


_NODES, _WEIGHTS = _cubature()


def centroids(device: CameraModel, rotation: Array, translation: Array, points: Array, radius_mm: float) -> Array:
    """Centroids of the images of circles on a board.

    Args:
        device: the intrinsic part is used; its own pose is not.
        rotation, translation: (3, 3) and (3,) mm, board to device: ``X_device = R X_board + t``.
        points: (n, 3) centres of the circles, mm on the board; the circles lie in the board's xy plane.
        radius_mm: of the circles; 0 gives the images of the centres.

    Returns:
        (n, 2) pixels; NaN where a circle is not in front of the device.
    """
    pixels, density = _images(device, rotation, translation, points, radius_mm)
    weight = density * _WEIGHTS
    return np.asarray((pixels * weight[..., None]).sum(axis=1) / weight.sum(axis=1)[:, None])


def offsets(device: CameraModel, rotation: Array, translation: Array, points: Array, radius_mm: float) -> Array:
    """Centroid of the image minus image of the centre, (n, 2) pixels; arguments as :func:`centroids`.

    It changes so little with the model that a bundle adjustment may keep it fixed between its outer steps.
    """
    centres = device.to_pixels(device.distort(_normalised(points @ rotation.T + translation)))
    return centroids(device, rotation, translation, points, radius_mm) - centres


def areas(device: CameraModel, rotation: Array, translation: Array, points: Array, radius_mm: float) -> Array:
    """Areas of the images of circles, (n,) square pixels; arguments as :func:`centroids`."""
    density = _images(device, rotation, translation, points, radius_mm)[1]
    return np.asarray(np.pi * radius_mm**2 * (density * _WEIGHTS).sum(axis=1))


def diameter_mm(areas_px: Array, device: CameraModel, rotation: Array, translation: Array, points: Array) -> float:
    """Diameter of equal circles from the areas of their images: the median over the circles.

    Args:
        areas_px: (n,) measured areas; those that are not finite are left out.
        device, rotation, translation: as :func:`centroids`.
        points: (n, 3) centres of the circles, mm.

    Returns:
        mm; NaN when there is no usable circle.
    """
    radius = 0.0
    for _ in range(_STEPS):
        density = (_images(device, rotation, translation, points, radius)[1] * _WEIGHTS).sum(axis=1)
        squared = np.asarray(areas_px) / (np.pi * density)
        squared = squared[np.isfinite(squared)]
        radius = float(np.sqrt(np.median(squared))) if len(squared) else float("nan")
    return 2 * radius


def _normalised(device_points: Array) -> Array:
    z = np.where(device_points[..., 2] > 0, device_points[..., 2], np.nan)
    return np.asarray(device_points[..., :2] / z[..., None])


def _images(
    device: CameraModel, rotation: Array, translation: Array, points: Array, radius_mm: float
) -> tuple[Array, Array]:
    """Pixels (n, 12, 2) of the cubature's nodes, and square pixels per square millimetre there (n, 12)."""
    nodes = np.repeat(np.asarray(points, dtype=np.float64)[:, None], len(_NODES), axis=1)
    nodes[..., :2] += radius_mm * _NODES
    seen = nodes @ np.asarray(rotation).T + translation
    normal = np.asarray(rotation)[:, 2]
    ideal = _normalised(seen)
    perspective = (seen @ normal) / seen[..., 2] ** 3
    matrix = device.matrix
    density = np.abs(matrix[0, 0] * matrix[1, 1] * perspective * _distortion_determinant(ideal, device.distortion))
    return device.to_pixels(device.distort(ideal)), density


def _distortion_determinant(ideal: Array, coefficients: Array) -> Array:
    """Determinant of the derivative of :func:`pipeline.rig.camera_model.distort` at ideal points (..., 2)."""
    xx, xy, yy = distortion_slopes(ideal, coefficients)
    return np.asarray(xx * yy - xy * xy)
