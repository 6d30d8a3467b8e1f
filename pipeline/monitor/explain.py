"""Explanation of drift: the rotation of one device that fits the changes of the readings best.

A rotation by a few thousandths of a degree and a shift of the lens have almost the same effect, so rotations stand for
both. A rotated right camera displaces the right image, to which the residual responds by
:func:`pipeline.monitor.sensitivity.displacement_response`; a rotated projector changes the predicted column itself; a
rotated left camera rotates the world, which moves both in the opposite direction. The devices are distinguished by the
change of the residual across the image: left and right camera give slopes of opposite sign.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.monitor import sensitivity
from pipeline.monitor.observe import Reading
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel

F64 = NDArray[np.float64]

DEVICES = ("left", "right", "projector")
GEOMETRY = ("column_px", "column_x_px", "column_y_px", "epipolar_px")
PRIOR_DEG = 0.2
_FLOOR = {"column_px": 0.003, "column_x_px": 0.003, "column_y_px": 0.003, "epipolar_px": 0.02}
_STEP_DEG = 0.01
_GOOD, _WORSE, _LARGER = 25.0, 6.0, 3.0


@dataclass(frozen=True, slots=True)
class Rotation:
    """Rotation of one device, as an explanation of changed readings.

    Args:
        device: ``left``, ``right`` or ``projector``.
        angle_deg, sigma_deg: about its own x, y, z, degrees; unobservable components keep the prior's sigma.
        misfit: sum of squares of the unexplained changes, in standard deviations.
    """

    device: str
    angle_deg: tuple[float, float, float]
    sigma_deg: tuple[float, float, float]
    misfit: float


def rotated(calibration: Calibration, device: str, angle_deg: tuple[float, float, float]) -> Calibration:
    """The calibration of a rig with a device rotated about its centre; the left camera stays the world frame."""
    by = _rotation(np.deg2rad(np.array(angle_deg)))
    if device == "left":
        right, projector = (
            _posed(one, one.rotation @ by.T, one.translation) for one in (calibration.right, calibration.projector)
        )
        return replace(calibration, right=right, projector=projector)
    one: CameraModel = getattr(calibration, device)
    moved = _posed(one, by @ one.rotation, by @ one.translation)
    if device == "right":
        return replace(calibration, right=moved)
    return replace(calibration, projector=moved)


def _posed(device: CameraModel, rotation: F64, translation: F64) -> CameraModel:
    # Rounding of successive rotations must not accumulate.
    u, _, v = np.linalg.svd(rotation)
    return CameraModel(device.size, device.matrix, device.distortion, u @ v, translation, device.name)


def _rotation(vector: F64) -> F64:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def signature(calibration: Calibration, shape: F64, first: int, device: str) -> F64:
    """(4, 3) readings :data:`GEOMETRY` per degree of rotation of the device about x, y, z, for these patches."""
    points = shape[:, :3]
    by_u, by_v = sensitivity.displacement_response(calibration, shape, first)
    design = sensitivity.design(calibration, shape, first)
    out = np.empty((4, 3))
    for axis in range(3):
        rotation = (_STEP_DEG * (axis == 0), _STEP_DEG * (axis == 1), _STEP_DEG * (axis == 2))
        after = rotated(calibration, device, rotation)
        shift = after.right.project(points) - calibration.right.project(points)
        sent = after.projector.project(points) - calibration.projector.project(points)
        column = by_u * shift[:, 0] + by_v * shift[:, 1] + sent[:, first]
        out[:3, axis] = np.linalg.lstsq(design, column, rcond=None)[0][:3]
        out[3, axis] = shift[:, 1 - first].mean()
    return out / _STEP_DEG


def explain(calibration: Calibration, shape: F64, first: int, changes: Mapping[str, Reading]) -> list[Rotation]:
    """Rotations of each device that explain changes of the readings, the best first.

    Args:
        shape: (n, 14) of patches, see :func:`pipeline.monitor.patches.measure_patches`.
        changes: of some of :data:`GEOMETRY`; others are ignored.
    """
    names = [name for name in GEOMETRY if name in changes]
    rows = [GEOMETRY.index(name) for name in names]
    value = np.array([changes[name].value for name in names])
    # The model is linear and the scene differs from that of the reference: 1 % of each change is uncertain.
    sigma = np.array([np.hypot(changes[name].sigma, _FLOOR[name]) for name in names]) + 0.01 * np.abs(value)
    out = []
    for device in DEVICES:
        matrix = signature(calibration, shape, first, device)[rows] / sigma[:, None]
        normal = matrix.T @ matrix + np.eye(3) / PRIOR_DEG**2
        rotation = np.linalg.solve(normal, matrix.T @ (value / sigma))
        left = value / sigma - matrix @ rotation
        spread = np.sqrt(np.diag(np.linalg.inv(normal)))
        out.append(Rotation(device, _triple(rotation), _triple(spread), float(left @ left)))
    return sorted(out, key=lambda one: one.misfit)


def unambiguous(explanations: list[Rotation]) -> Rotation | None:
    """The only good explanation by a rotation not much larger than another one's; None if there are two."""
    good = [one for one in explanations if one.misfit < _GOOD and one.misfit < explanations[0].misfit + _WORSE]
    sizes = [float(np.linalg.norm(one.angle_deg)) for one in good]
    small = [one for one, size in zip(good, sizes, strict=True) if size <= _LARGER * min(sizes)]
    return small[0] if len(small) == 1 else None


def _triple(values: F64) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
