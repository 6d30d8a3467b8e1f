"""Recommendations for the layout of a rig that was calibrated."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.calibrate.bundle.solution import Solution
from pipeline.common.errors import CalibrationError
from pipeline.pattern.order_check import GOLDEN, order_check
from pipeline.rig.calibration import Cameras
from pipeline.rig.volume import Volume


def layout_recommendations(cameras: Cameras, solution: Solution) -> tuple[list[str], dict[str, Any]]:
    """Recommendations for the rig's layout, and figures for the file's quality.

    The layout is assessed for the depths at which the board was shown.
    """
    base = cameras.baseline_mm
    if cameras.projector is None:
        return [
            f"place the projector {GOLDEN * base:.0f} or {(1 - GOLDEN) * base:.0f} mm along the {base:.0f} mm from the "
            "left to the right camera, not in the middle: at an integer ratio of the baselines flat surfaces carry no "
            "fringe order"
        ], {}
    positions = [solution.board_points @ pose[0].T + pose[1] for pose in solution.poses if pose is not None]
    depths = np.concatenate(positions)[:, 2]
    try:
        check = order_check(cameras.complete(), Volume(float(depths.min()), float(depths.max())))
    except CalibrationError as error:
        return [str(error)], {}
    return [check.recommendation], {"order_ratio": round(check.ratio, 4), "order_merit": round(check.merit, 3)}
