"""Which device has moved: what small turns of each would make of the readings, compared with what they are.

A turn of a device by a few thousandths of a degree and a shift of its lens look almost alike, so turns stand for both.
For a point X on its left ray, a turned right camera displaces the right image by (du, dv), to which the residual
answers as :func:`pipeline.monitor.sensitivity.answers` has it; a turned projector changes the predicted column itself;
a turned left camera is a turn of the world, which moves both the other way. What tells them apart is how the residual
changes across the image: left and right camera give slopes of opposite sign.
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
class Turn:
    """A device that was turned, as an explanation.

    Args:
        device: ``left``, ``right`` or ``projector``.
        turn_deg, sigma_deg: about its own x, y, z, degrees; what the readings do not tell keeps its prior's sigma.
        misfit: sum of squares of what it leaves unexplained, in standard deviations.
    """

    device: str
    turn_deg: tuple[float, float, float]
    sigma_deg: tuple[float, float, float]
    misfit: float


def turned(calibration: Calibration, device: str, turn_deg: tuple[float, float, float]) -> Calibration:
    """The calibration of a rig whose device was turned about its centre; the left camera stays the world frame."""
    turn = _rotation(np.deg2rad(np.array(turn_deg)))
    if device == "left":
        right, projector = (
            _posed(one, one.rotation @ turn.T, one.translation) for one in (calibration.right, calibration.projector)
        )
        return replace(calibration, right=right, projector=projector)
    one: CameraModel = getattr(calibration, device)
    moved = _posed(one, turn @ one.rotation, turn @ one.translation)
    if device == "right":
        return replace(calibration, right=moved)
    return replace(calibration, projector=moved)


def _posed(device: CameraModel, rotation: F64, translation: F64) -> CameraModel:
    # Rounding of many turns must not add up.
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
    """(4, 3) readings :data:`GEOMETRY` per degree of a turn of the device about x, y, z, for these patches."""
    points = shape[:, :3]
    by_u, by_v = sensitivity.answers(calibration, shape, first)
    design = sensitivity.design(calibration, shape, first)
    out = np.empty((4, 3))
    for axis in range(3):
        turn = (_STEP_DEG * (axis == 0), _STEP_DEG * (axis == 1), _STEP_DEG * (axis == 2))
        after = turned(calibration, device, turn)
        seen = after.right.project(points) - calibration.right.project(points)
        sent = after.projector.project(points) - calibration.projector.project(points)
        column = by_u * seen[:, 0] + by_v * seen[:, 1] + sent[:, first]
        out[:3, axis] = np.linalg.lstsq(design, column, rcond=None)[0][:3]
        out[3, axis] = seen[:, 1 - first].mean()
    return out / _STEP_DEG


def explain(calibration: Calibration, shape: F64, first: int, changes: Mapping[str, Reading]) -> list[Turn]:
    """Every device as an explanation of some changes of the readings, the best first.

    Args:
        shape: (n, 14) of patches, see :func:`pipeline.monitor.patches.measure_patches`.
        changes: of some of :data:`GEOMETRY`; others are not looked at.
    """
    names = [name for name in GEOMETRY if name in changes]
    rows = [GEOMETRY.index(name) for name in names]
    value = np.array([changes[name].value for name in names])
    # The model is linear and the scene is not quite the one of the reference: a hundredth of each change is not told.
    sigma = np.array([np.hypot(changes[name].sigma, _FLOOR[name]) for name in names]) + 0.01 * np.abs(value)
    out = []
    for device in DEVICES:
        matrix = signature(calibration, shape, first, device)[rows] / sigma[:, None]
        normal = matrix.T @ matrix + np.eye(3) / PRIOR_DEG**2
        turn = np.linalg.solve(normal, matrix.T @ (value / sigma))
        left = value / sigma - matrix @ turn
        spread = np.sqrt(np.diag(np.linalg.inv(normal)))
        out.append(Turn(device, _triple(turn), _triple(spread), float(left @ left)))
    return sorted(out, key=lambda one: one.misfit)


def clear(explanations: list[Turn]) -> Turn | None:
    """The only explanation that is good and needs no turn much larger than another one's; None where two are."""
    good = [one for one in explanations if one.misfit < _GOOD and one.misfit < explanations[0].misfit + _WORSE]
    sizes = [float(np.linalg.norm(one.turn_deg)) for one in good]
    small = [one for one, size in zip(good, sizes, strict=True) if size <= _LARGER * min(sizes)]
    return small[0] if len(small) == 1 else None


def _triple(values: F64) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
