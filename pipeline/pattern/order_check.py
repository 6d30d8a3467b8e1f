"""Figure of merit of a rig's layout for the fringe order check by the second camera.

Three equal fringes carry no order. A candidate that is wrong by m periods makes, on a plane, a phase residual of
``2 pi frac(m rho)`` in the other camera, ``rho`` = baseline to the other camera over baseline to the projector, both
along the fringes' axis. Where ``m rho`` is near an integer the check fails: with the projector in the middle (2) or
at a quarter (4) of the baseline. The best position divides the baseline in the golden ratio: 0.382 or 0.618 of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume

Array = NDArray[np.float64]

GOLDEN = (3 - 5**0.5) / 2
"""0.382: the most irrational division of a length, and so the best position of the projector."""
GOOD, POOR = 0.6, 0.25
_LEAST_SHIFTS = 12.0
"""Smallest depth that is assessed, in periods of disparity between the cameras."""
_MOST_ORDERS, _MOST_RATIO = 32, 50.0


@dataclass(frozen=True, slots=True)
class OrderCheck:
    """The assessment of a layout.

    Args:
        ratio: rho seen from the left camera.
        ratio_right: seen from the right camera.
        fraction: where the projector stands between left (0) and right (1), along the fringes' axis.
        merit: 0 (blind) to 1 (golden ratio).
        weakest: the wrong order that is hardest to notice, in periods.
        residual_rad: its phase residual on a plane.
        orders: candidates in the volume at the middle of the left image.
        recommendation: text for the user.
    """

    ratio: float
    ratio_right: float
    fraction: float
    merit: float
    weakest: int
    residual_rad: float
    orders: int
    recommendation: str

    @property
    def good(self) -> bool:
        """Whether nothing needs to be done."""
        return self.merit >= GOOD


def order_check(
    calibration: Calibration, volume: Volume, *, periods: float = 96.0, axis: Literal["x", "y"] = "x"
) -> OrderCheck:
    """Figure of merit of a calibrated rig.

    Args:
        calibration: the rig.
        volume: of the measurement; its middle is assessed.
        periods: of the fringe over the projector's width (height for axis y).
        axis: along which the phase grows.

    Raises:
        CalibrationError: the middle of the volume is not in front of all devices.
    """
    along = 0 if axis == "x" else 1
    left, right, projector = calibration.left, calibration.right, calibration.projector
    ray = np.append(left.normalise((np.array(left.size) - 1.0) / 2), 1.0)
    middle = ray * (volume.near_mm + volume.far_mm) / 2
    normal = left.rotation[2] + right.rotation[2]
    if not all(np.isfinite(device.project(middle)).all() for device in (left, right, projector)):
        raise CalibrationError(
            f"the point {np.round(middle)} mm in the middle of the volume is not in front of all devices"
        )
    ratio = _ratio(left, right, projector, middle, normal, along)
    ratio_right = _ratio(right, left, projector, middle, normal, along)
    if not (np.isfinite(ratio) and np.isfinite(ratio_right)):
        raise CalibrationError(
            "the projector stands, along its fringes' axis, where one camera stands: its columns do not determine "
            "the depth; move it between the cameras, to 0.382 or 0.618 of the baseline"
        )
    period = projector.size[along] / periods
    ends = projector.project(np.stack([ray * volume.near_mm, ray * volume.far_mm]))[:, along]
    steps = float(abs(ends[1] - ends[0]) / period) if np.isfinite(ends).all() else 0.0
    orders = int(min(steps, 10_000)) + 1
    merit, weakest, residual = merit_of(ratio, ratio_right, max(_LEAST_SHIFTS, steps * abs(ratio)))
    fraction = 1 / ratio
    recommendation = _recommendation(calibration, fraction, merit, weakest, residual)
    return OrderCheck(ratio, ratio_right, fraction, merit, weakest, residual, orders, recommendation)


def merit_of(ratio: float, ratio_right: float, shifts: float) -> tuple[float, int, float]:
    """(merit, weakest wrong order, its residual in radians) of the ratios seen from both cameras.

    The distance of ``m rho`` from the nearest integer shrinks like 1 / m whatever the ratio; times m its least value
    over all m is largest for the golden ratio (Hurwitz' theorem), which gives 1. An error that moves a surface by a
    share of the volume can occur only in the rest of the volume, and counts less by that.

    Args:
        ratio, ratio_right: rho seen from left and right.
        shifts: the volume's depth in steps of one period of disparity between the cameras.
    """
    worst = (float("inf"), 1, float(np.pi))
    for rho in (abs(ratio), abs(ratio_right)):
        for m in range(1, max(1, min(int(shifts / rho), _MOST_ORDERS)) + 1):
            away = abs(m * rho - round(m * rho))
            share = max(1 - m * rho / (shifts + 1), 1 / (shifts + 1))
            worst = min(worst, (m * away / share, m, 2 * float(np.pi) * away))
    return min(1.0, worst[0] / GOLDEN), worst[1], worst[2]


def order_warning(calibration: Calibration, volume: Volume, pattern: ColorFringe) -> str:
    """Why points with wrong fringe orders may be published; empty if the layout or the pattern prevents it.

    Frequency-modulated fringes carry the order; equal ones need a layout with a merit of ``POOR`` at least.
    """
    if pattern.profile is not None:
        return ""
    try:
        check = order_check(calibration, volume, periods=pattern.periods, axis=pattern.axis)
    except CalibrationError as error:
        return str(error)
    return f"surfaces may be at a wrong depth: {check.recommendation}" if check.merit < POOR else ""


def _ratio(
    first: CameraModel, other: CameraModel, projector: CameraModel, point: Array, normal: Array, along: int
) -> float:
    """Rho seen from ``first``: by exact derivatives at a point of a plane, for any poses of the devices."""
    ray = point - first.centre
    ray = ray / np.linalg.norm(ray)
    n = normal / np.linalg.norm(normal)
    plane = np.linalg.svd(n[None])[2][1:]
    seen = _slope(other, point)
    # The point on the plane with the other camera's pixel when the point moves along the ray of the first.
    on_plane = plane.T @ np.linalg.solve(seen @ plane.T, seen @ ray)
    columns = _slope(projector, point)[along]
    by_candidate, by_plane = float(columns @ ray), float(columns @ on_plane)
    return by_plane / by_candidate if abs(by_candidate) > abs(by_plane) / _MOST_RATIO else float("inf")


def _slope(device: CameraModel, point: Array) -> Array:
    """Derivative (2, 3) of the pixel by the world point."""
    step = 1e-4 * float(np.linalg.norm(device.rotation @ point + device.translation))
    ends = device.project(point + step * np.concatenate([np.eye(3), -np.eye(3)]))
    return np.asarray((ends[:3] - ends[3:]).T / (2 * step))


def _recommendation(calibration: Calibration, fraction: float, merit: float, weakest: int, residual: float) -> str:
    position = f"the projector stands at {fraction:.3f} of the baseline of {calibration.baseline_mm:.0f} mm"
    if merit >= GOOD:
        return f"{position}: fringe orders are distinguished well (merit {merit:.2f})"
    best = min((GOLDEN, 1 - GOLDEN), key=lambda target: abs(fraction - target))
    shift = (best - fraction) * calibration.baseline_mm
    move = f"move it {abs(shift):.0f} mm towards the {'right' if shift > 0 else 'left'} camera, to {best:.3f}"
    noticed = "hardly noticed" if merit >= POOR else "not noticed"
    return (
        f"{position}: an order wrong by {weakest} is {noticed} (phase residual {residual:.2f} rad on a plane, merit "
        f"{merit:.2f}); {move}, or use a frequency-modulated fringe"
    )
