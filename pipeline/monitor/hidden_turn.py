"""The turn of the right camera that shifts every fringe order by one, and how much of it one pair shows.

A turn about the camera's vertical axis displaces the matches along the epipolar lines, and so the predicted projector
columns, nearly alike everywhere. Where the displacement is one fringe period, the fringes fit again: no offset is left.
Perspective leaves a slope over the image, the less the narrower the field and the smaller the angle between the
cameras.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.monitor import sensitivity
from pipeline.monitor.check.limits import LIMITS
from pipeline.monitor.explain import rotated
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

F64 = NDArray[np.float64]

_PER_SIDE = 9
"""Points along each side of the image, and the least number that all devices must see."""
_ROUNDS = 4
_LARGEST = np.radians(10.0)
"""Such a turn leaves nothing in view."""


class HiddenTurn(NamedTuple):
    """A turn of the right camera after which the fringes fit again.

    Args:
        degrees: smallest angle, about the camera's axis across the fringes; depth_mm: by which all surfaces are off.
        slope_deg: what remains of the projector's column residual, from the middle of the image to its edge.
        hidden: whether that is less than the limit of the calibration check.
    """

    degrees: float
    depth_mm: float
    slope_deg: float
    hidden: bool


def hidden_turn(calibration: Calibration, pattern: ColorFringe, volume: Volume) -> HiddenTurn | None:
    """The turn for plain fringes, on a plane in the middle of the volume.

    None where not all devices see that, or where the projector stands so near to the left camera that no turn changes
    its columns by a period.
    """
    first = 0 if pattern.axis == "x" else 1
    width, height = calibration.left.size
    grid = np.stack(np.meshgrid(*(np.linspace(0, n - 1, _PER_SIDE) for n in (width, height))), axis=-1).reshape(-1, 2)
    points = np.column_stack([calibration.left.normalise(grid), np.ones(len(grid))])
    points *= (volume.near_mm + volume.far_mm) / 2
    for device in (calibration.right, calibration.projector):
        pixels = device.project(points)
        points = points[((pixels >= 0) & (pixels < device.size)).all(axis=1)]
    if len(points) < _PER_SIDE:
        return None
    period, angle = pattern.length / pattern.periods, 1e-4
    for _ in range(_ROUNDS):
        columns, _ = _errors(calibration, points, first, angle)
        angle *= period / max(abs(float(np.median(columns))), 1e-9)
        if angle > _LARGEST:
            return None
    columns, depth = _errors(calibration, points, first, angle)
    x, y = sensitivity.in_image(calibration, points)
    design = np.stack([np.ones_like(x), x, y], axis=1)
    per_column = np.degrees(1 / calibration.projector.matrix[first, first])
    slopes = np.abs(np.linalg.lstsq(design, columns, rcond=None)[0][1:]) * per_column
    shown = slopes / [LIMITS[name][0][1] for name in ("column_x", "column_y")]
    return HiddenTurn(
        float(np.degrees(angle)), float(abs(np.median(depth))), float(slopes.max()), bool(shown.max() < 1)
    )


def _errors(calibration: Calibration, points: F64, first: int, angle: float) -> tuple[F64, F64]:
    """Errors (n,) of projector column and depth, of points that a turned right camera sees."""
    degrees = float(np.degrees(angle))
    # With these signs the image moves towards larger coordinates along either axis.
    turned = rotated(calibration, "right", (0.0, degrees, 0.0) if first == 0 else (-degrees, 0.0, 0.0))
    seen = turned.right.project(points)
    found = points.copy()
    for _ in range(_ROUNDS):
        _, per_mm = sensitivity.along_ray(calibration, found, first)
        missing = seen[:, first] - calibration.right.project(found)[:, first]
        found *= 1 + (missing / per_mm[:, first] / found[:, 2])[:, None]
    columns = calibration.projector.project(found) - calibration.projector.project(points)
    return columns[:, first], found[:, 2] - points[:, 2]
