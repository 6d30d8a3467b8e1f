"""Check of the column correction that the first set of a multi-frame mode gives.

The metric comes from the cameras, so a turn of one about its vertical axis displaces the whole surface and leaves only
a constant offset of the columns, which the correction takes up. What it takes up beyond a projector's drift is a
finding. Roll shows as a slope across the columns; a turn about the horizontal axis does not show.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.monitor import sensitivity
from pipeline.monitor.check.cause import cause_of
from pipeline.monitor.check.checked_reconstructor import Policy
from pipeline.monitor.check.limits import depth_offsets, judged
from pipeline.reconstruct.consistency import Consistency, Reading
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume


def options_for(policy: Policy) -> dict[str, Any]:
    """Options of a ``SetReconstructor`` whose sets are checked by this policy."""
    return {"check": None if policy == "off" else SetCheck, "withhold": policy == "withhold"}


class SetCheck:
    """Judges column corrections.

    Args:
        calibration, volume: of the rig.
        first: 0 if the phase grows along the projector's columns, 1 along its rows.
    """

    def __init__(self, calibration: Calibration, volume: Volume, first: int) -> None:
        self._calibration, self._first = calibration, first
        device = calibration.projector
        size = np.array([device.size[first], device.size[1 - first]]) - 1.0
        self._middle, self._half = np.array([1.0, *(size / 2)]), size / 2
        self._degrees = float(np.degrees(1 / device.matrix[first, first]))
        point = sensitivity.in_the_middle(calibration, (volume.near_mm + volume.far_mm) / 2)
        left, right = sensitivity.per_depth(calibration, point, first)
        self._per_mm = float(left[0]), float(right[0])

    def __call__(self, correction: NDArray[np.float64], measured: bool) -> Consistency:
        """The verdict on a correction (3,): offset, slope along, slope across; unknown where it was not measured."""
        if not measured:
            return Consistency("unknown")
        offset = float(correction @ self._middle)
        # Along the fringes' axis and across it, which is x and y of the images or the reverse.
        slopes = (correction[1:] * self._half * self._degrees).tolist()
        horizontal, vertical = slopes if self._first == 0 else slopes[::-1]
        readings = {
            "column_offset": Reading(offset * self._degrees, 0.0),
            **depth_offsets(Reading(offset, 0.0), self._per_mm),
            "column_x": Reading(horizontal, 0.0),
            "column_y": Reading(vertical, 0.0),
        }
        return judged(readings, cause_of(readings, self._calibration))
