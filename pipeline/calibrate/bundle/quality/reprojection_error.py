"""Reprojection error and epipolar distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.adjust.projection import image_with_slopes
from pipeline.calibrate.bundle.adjust.state import cross_matrices, intrinsics_of
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]


def rms(misfit: Array) -> float:
    """Root of the mean squared distance, (n, 2) px; NaN without marks."""
    return float(np.sqrt((misfit**2).sum(axis=1).mean())) if len(misfit) else float("nan")


def epipolar_distances(left: CameraModel, right: CameraModel, in_left: Array, in_right: Array) -> Array:
    """Distances (2 n,) of undistorted pixels from the epipolar lines of their partners, in both images.

    Pixels are undistorted with each camera's own matrix kept, as OpenCV's ``undistortPoints`` with ``P`` does.

    Args:
        left: the world.
        right: with its pose.
        in_left, in_right: (n, 2) pixels of the same points.
    """
    essential = cross_matrices(right.translation[None])[0] @ right.rotation
    fundamental = np.linalg.inv(right.matrix).T @ essential @ np.linalg.inv(left.matrix)
    a = _homogeneous(left.to_pixels(left.normalise(in_left)))
    b = _homogeneous(right.to_pixels(right.normalise(in_right)))
    in_right_lines, in_left_lines = a @ fundamental.T, b @ fundamental
    top = np.abs((b * in_right_lines).sum(axis=1))
    return np.concatenate(
        [top / np.linalg.norm(in_left_lines[:, :2], axis=1), top / np.linalg.norm(in_right_lines[:, :2], axis=1)]
    )


def epipolar_px(left: CameraModel, right: CameraModel, data: Observations, offsets: Array) -> float:
    """Mean epipolar distance over the marks that devices 0 and 1 both detected; NaN without any."""
    first, second = {}, {}
    for device, view, where in data.groups():
        for mark, pixel in zip(data.mark[where].tolist(), data.pixels[where] - offsets[where], strict=True):
            if device == 0:
                first[view, mark] = pixel
            elif device == 1:
                second[view, mark] = pixel
    both = [key for key in first if key in second]
    if not both:
        return float("nan")
    in_left, in_right = np.array([first[key] for key in both]), np.array([second[key] for key in both])
    return float(epipolar_distances(left, right, in_left, in_right).mean())


def difference_px(one: CameraModel, other: CameraModel, *, rotation_removed: bool = True) -> Array:
    """Difference of the pixels of the same ray by two models of one device, (rows, columns, 2) px, on an image grid.

    Args:
        one: the model whose pixels define the rays.
        other: of the same size.
        rotation_removed: whether the best small rotation is removed first: a shifted principal point is nearly a
            rotated device, for which the poses found with each model compensate.
    """
    width, height = one.size
    u, v = np.meshgrid(np.linspace(0, width - 1, 21), np.linspace(0, height - 1, 17))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    rays = _homogeneous(one.normalise(pixels))
    projected, _, of_ray = image_with_slopes(intrinsics_of(other), rays)
    deviation = projected - pixels
    if rotation_removed:
        by_rotation = np.cross(rays[:, None], of_ray).reshape(-1, 3)
        rotation = np.linalg.lstsq(by_rotation, -deviation.ravel(), rcond=None)[0]
        deviation = deviation + (by_rotation @ rotation).reshape(-1, 2)
    return np.asarray(deviation.reshape(17, 21, 2))


def _homogeneous(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])
