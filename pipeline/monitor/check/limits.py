"""Limits of the readings of a pair, and the verdict by them."""

from __future__ import annotations

import numpy as np

from pipeline.reconstruct.consistency import Consistency, Reading

LIMITS: dict[str, tuple[tuple[float, float], str]] = {
    "column_offset": ((0.012, 0.030), "degrees of the projector"),
    "depth_offset": ((2.0, 4.0), "mm of depth, if it was the right camera"),
    "column_x": ((0.006, 0.010), "degrees of the projector, middle to edge"),
    "column_y": ((0.0025, 0.0050), "degrees of the projector, middle to edge"),
    "column_scatter": ((0.025, 0.032), "rad of the fringe's phase"),
    "epipolar": ((0.014, 0.025), "degrees of the right camera"),
    "epipolar_x": ((0.030, 0.050), "degrees of the right camera, middle to edge"),
    "epipolar_y": ((0.020, 0.040), "degrees of the right camera, middle to edge"),
    "left_roll": ((0.020, 0.033), "degrees"),
    "right_roll": ((0.020, 0.033), "degrees"),
    "order_cost": ((0.50, 0.60), "of the cost of unrelated phases"),
    "order_cost_beside_agreement": ((0.50, np.inf), "of the cost of unrelated phases"),
    "scanned_drift": ((0.012, 0.030), "degrees of the projector"),
    "scanned_offset": ((np.inf, 0.0), "degrees of the projector"),
    "scanned_change": ((np.inf, 0.0), "degrees of the projector"),
    "scanned_epipolar": ((np.inf, 0.0), "degrees of the right camera"),
}
"""Limit of ``doubtful``, limit of ``inconsistent``, unit."""
SIGMAS = 4.0
"""A reading is beyond a limit when it is so by this many of its standard deviations."""


def judged(readings: dict[str, Reading], cause: str = "") -> Consistency:
    """The verdict of readings: the worst of all; unknown where the surface gives none."""
    findings, worst = [], 0
    for name, reading in readings.items():
        level = 2 if excess(name, reading) > 0 else 1 if excess(name, reading, which=0) > 0 else 0
        if level:
            limits, unit = LIMITS[name]
            findings.append(f"{name} {reading.value:+.4f} +- {reading.sigma:.4f}, limit {limits[level - 1]:g} {unit}")
        worst = max(worst, level)
    if "column_offset" not in readings and worst < 2:
        return Consistency("unknown", readings, tuple(findings))
    verdict = ("consistent", "doubtful", "inconsistent")[worst]
    return Consistency(verdict, readings, tuple(findings), cause if worst == 2 else "")  # type: ignore[arg-type]


def excess(name: str, reading: Reading, which: int = 1) -> float:
    """How far a reading is beyond a limit for certain.

    The deviation of a scatter is proportional to the scatter itself. What a rig at the limit would show is decisive, so
    the deviation is that of the limit; of what was read it would grow with it, and hide a scatter of twice the limit.
    """
    value, limit = abs(reading.value), LIMITS[name][0][which]
    sigma = reading.sigma * min(1.0, limit / value) if name == "column_scatter" and value else reading.sigma
    return value - SIGMAS * sigma - limit
