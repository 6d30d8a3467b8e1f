"""What has moved, if readings are beyond their limits."""

from __future__ import annotations

from pipeline.monitor.check.limits import excess
from pipeline.reconstruct.consistency import Reading
from pipeline.rig.calibration import Calibration

LEAST_SHARE = 0.05
"""Least share of the baseline that angles are computed with."""


def cause_of(readings: dict[str, Reading], calibration: Calibration) -> str:
    """Device, axis and angle that explain the largest reading; two devices where they cannot be separated."""
    beyond = {name: abs(reading.value) for name, reading in readings.items() if excess(name, reading) > 0}
    scanned = [name for name in ("scanned_offset", "scanned_change") if name in beyond]
    if scanned or beyond.keys() & {"column_offset", "scanned_drift", "depth_offset", "depth_offset_left"}:
        measured = "column_offset" if "column_offset" in readings else "scanned_drift"
        offset = abs(readings[(*scanned, measured)[0]].value)
        of_right, of_left = (offset / share for share in baseline_shares(calibration))
        return (
            f"the right camera is turned about its vertical axis by {of_right:.2f} degrees, the left one by "
            f"{of_left:.2f} degrees, or the projector by {offset:.2f} degrees: one pair does not separate them"
        )
    for name in ("scanned_epipolar", "epipolar"):
        if name in beyond:
            return f"a camera is turned about its horizontal axis by {beyond[name]:.2f} degrees"
    for side in ("right", "left"):
        if f"{side}_roll" in beyond:
            angle = beyond[f"{side}_roll"]
            return f"the {side} camera is turned about its optical axis by {angle:.2f} degrees"
    if "epipolar_x" in beyond or "epipolar_y" in beyond:
        return "a camera is turned about its optical axis, or its lens differs from the calibrated one"
    if "column_y" in beyond:
        angle = beyond["column_y"] / (0.5 * calibration.left.size[1] / calibration.left.matrix[1, 1])
        return f"the projector is turned about its optical axis by {angle:.2f} degrees"
    if "column_x" in beyond:
        return "a focal length differs from the calibrated one, or a device has moved along the baseline"
    if "order_cost" in beyond:
        return "the images do not belong to this calibration: cameras exchanged, or a device has moved far"
    return "a device has moved" if beyond else ""


def baseline_shares(calibration: Calibration) -> tuple[float, float]:
    """Distances of the projector from the left and from the right camera over the distance of the cameras."""
    left, right = calibration.left.centre, calibration.right.centre
    share = float((calibration.projector.centre - left) @ (right - left) / ((right - left) @ (right - left)))
    return max(abs(share), LEAST_SHARE), max(abs(1 - share), LEAST_SHARE)
