"""Offsets of the centroids of all circles' images from the images of their centres."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.adjust.state import State
from pipeline.calibrate.targets.localise import circle_projection
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]


def offsets(state: State, data: Observations, diameter_mm: float) -> Array:
    """Centroid of the circle's image minus image of its centre, (n, 2) px; zero for marks that are points."""
    result = np.zeros((len(data), 2))
    if diameter_mm <= 0:
        return result
    for where, model, rotation, translation in _images(state, data):
        points = state.points[data.mark[where]]
        result[where] = circle_projection.offsets(model, rotation, translation, points, diameter_mm / 2)
    result[~np.isfinite(data.area)] = 0.0
    return result


def diameter_mm(state: State, data: Observations) -> float:
    """The diameter that explains the measured areas best (median over the images); 0 without areas."""
    diameters = [
        circle_projection.diameter_mm(data.area[where], model, rotation, translation, state.points[data.mark[where]])
        for where, model, rotation, translation in _images(state, data)
    ]
    return float(np.median(diameters)) if diameters else 0.0


def _images(state: State, data: Observations) -> Iterator[tuple[slice, CameraModel, Array, Array]]:
    """Slice of the marks of each image with circles, its device, and the board's pose to the device."""
    models = [state.model(k, "device", (1, 1)) for k in range(state.devices)]
    for device, view, where in data.groups():
        if np.isfinite(data.area[where]).any():
            r, t = state.rotations[device], state.translations[device]
            translation = r @ state.view_translations[view] + t
            yield where, models[device], r @ state.view_rotations[view], translation
