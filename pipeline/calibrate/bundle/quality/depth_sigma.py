"""Standard deviation of measured depths that the uncertainty of the cameras' calibration causes.

A point's pixels in both cameras are kept while the cameras' parameters change by their standard deviations one after
the other; the changes of its depth are its derivatives, the covariance of the parameters is that of the adjustment.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.adjust.state import PER_DEVICE, PER_VIEW, State
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]
_MOST_POINTS = 400


def depth_sigma_mm(state: State, data: Observations, covariance: Array, sizes: list[tuple[int, int]]) -> float:
    """Root mean square over the observed marks of the standard deviation of their distance from the left camera, mm.

    Args:
        state: whose first two devices are the left and the right camera.
        data: its marks; those of the left camera are the points.
        covariance: (p, p) of the devices' unknowns, rotations as small ones; sizes: of the two cameras' images.
    """
    seen = data.device == 0
    step = max(1, int(np.ceil(np.count_nonzero(seen) / _MOST_POINTS)))
    view, mark = data.view[seen][::step], data.mark[seen][::step]
    points = np.einsum("nij,nj->ni", state.view_rotations[view], state.points[mark]) + state.view_translations[view]
    cameras = _cameras(state, sizes)
    pixels = [camera.project(points) for camera in cameras]
    before = distances(cameras, pixels)
    count = 2 * PER_DEVICE
    changes = np.zeros((len(points), count))
    for k, sigma in enumerate(np.sqrt(np.maximum(np.diag(covariance)[:count], 0.0))):
        if sigma > 0:
            change = np.zeros(PER_DEVICE * state.devices + PER_VIEW * state.views)
            change[k] = sigma
            changes[:, k] = (distances(_cameras(state.stepped(change), sizes), pixels) - before) / sigma
    variance = np.einsum("ni,ij,nj->n", changes, covariance[:count, :count], changes)
    return float(np.sqrt(np.maximum(variance, 0.0).mean()))


def _cameras(state: State, sizes: list[tuple[int, int]]) -> list[CameraModel]:
    return [state.model(k, name, sizes[k]) for k, name in enumerate(("left", "right"))]


def distances(cameras: list[CameraModel], pixels: list[Array]) -> Array:
    """Distance (n,) along the left camera's ray at which the right camera sees the point in its column."""
    left, right = cameras
    rays = np.column_stack([left.normalise(pixels[0]), np.ones(len(pixels[0]))])
    rotation = right.rotation @ left.rotation.T
    origin = right.translation - rotation @ left.translation
    seen, turned = right.normalise(pixels[1])[:, 0], rays @ rotation.T
    depth = (origin[0] - seen * origin[2]) / (seen * turned[:, 2] - turned[:, 0])
    return np.asarray(depth * np.linalg.norm(rays, axis=1))
