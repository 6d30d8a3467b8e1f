"""Limits of the readings of a pair, and the verdict by them."""

from __future__ import annotations

import numpy as np

from pipeline.reconstruct.consistency import Consistency, Reading

LIMITS: dict[str, tuple[tuple[float, float], str]] = {
    "column_offset": ((0.012, 0.030), "degrees of the projector"),
    "depth_offset": ((2.0, 4.0), "mm of depth, if it was the right camera"),
    "depth_offset_left": ((3.0, 6.0), "mm of depth, if it was the left camera"),
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
    "combined": ((1.0, 1.2), "(sum of the squares of all readings over their limits)"),
}
"""Limit of ``doubtful``, limit of ``inconsistent``, unit."""
SIGMAS = 4.0
"""A reading is beyond a limit when it is so by this many of its standard deviations."""
_COMBINED_SIGMAS = 3.0
_INDEPENDENT = (
    ("column_offset", "scanned_drift", "depth_offset"), ("column_x",), ("column_y",), ("column_scatter",),
    ("epipolar",), ("epipolar_x",), ("epipolar_y",), ("left_roll", "right_roll"), ("order_cost",),
)  # fmt: skip
"""Readings of which the largest of each row is combined with those of the others."""
_LEAST_RATIO = 0.05
"""Change of the projector's coordinate along one camera's rays over the other's, from which depths are computed."""


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


def depth_offsets(offset: Reading, per_mm: tuple[float, float]) -> dict[str, Reading]:
    """By how much a surface is displaced in depth if a turn of the right or the left camera causes a column offset.

    Args:
        offset: pixels of the projector; per_mm: change of its coordinate along left and right rays. A turned camera
            displaces points along the other one's rays; rays along which the coordinate hardly changes are left out.
    """
    names, largest = ("depth_offset", "depth_offset_left"), max(map(abs, per_mm))
    return {
        name: Reading(-offset.value / each, offset.sigma / abs(each))
        for name, each in zip(names, per_mm, strict=True)
        if abs(each) > _LEAST_RATIO * largest
    }


def combined(readings: dict[str, Reading]) -> Reading:
    """Sum of squares of what is certain of independent readings, over their limits of ``inconsistent``.

    A device that has moved shows in several of them, each of which may stay below its own limit.
    """
    shares = [
        max((_certain(readings[name]) / LIMITS[name][0][1] for name in names if name in readings), default=0.0)
        for names in _INDEPENDENT
    ]
    return Reading(float(np.square(shares).sum()), 0.0)


def _certain(reading: Reading) -> float:
    return max(0.0, abs(reading.value) - _COMBINED_SIGMAS * reading.sigma)


def excess(name: str, reading: Reading, which: int = 1) -> float:
    """How far a reading is beyond a limit for certain.

    The deviation of a scatter is proportional to the scatter itself. What a rig at the limit would show is decisive, so
    the deviation is that of the limit; of what was read it would grow with it, and hide a scatter of twice the limit.
    """
    value, limit = abs(reading.value), LIMITS[name][0][which]
    sigma = reading.sigma * min(1.0, limit / value) if name == "column_scatter" and value else reading.sigma
    return value - SIGMAS * sigma - limit
