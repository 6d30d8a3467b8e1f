"""A check of the calibrated projector against all pixels of the board, not only its marks.

Every white pixel visible to both cameras gives a point from the two cameras alone, and observed projector coordinates.
Their difference from the calibrated projector's prediction is the trinocular residual; it does not depend on the
board's print. If it is larger than the marks can resolve, the projector is refined. The cameras define the metric and
are not changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from daemon.apps.calibration.views.detect_marks import Phases
from pipeline.calibrate.projector.trinocular_residual import joined, refine_projector
from pipeline.calibrate.projector.trinocular_samples import samples_of_phases
from pipeline.common.errors import CalibrationError
from pipeline.rig.calibration import Calibration

WORTH_PX = 0.02
"""Smallest systematic residual that leads to a refinement."""
_GAIN = 0.5


@dataclass(frozen=True, slots=True)
class ProjectorCheck:
    """The residuals before and after, and the calibration to use.

    Args:
        calibration: with the projector refined, or as it was.
        residual_px: systematic part of observed minus predicted projector pixels, after the check.
        before_px: the same before a refinement.
        refined: whether the projector changed; note: a sentence for the report.
    """

    calibration: Calibration
    residual_px: float
    before_px: float
    refined: bool
    note: str


def check_projector(calibration: Calibration, phases: Sequence[tuple[Phases, Phases]]) -> ProjectorCheck | None:
    """Check the projector by all pixels of some views and refine it if necessary; None if the pixels do not suffice."""
    try:
        samples = joined(*(samples_of_phases(calibration, left, right) for left, right in phases))
        refinement = refine_projector(calibration, samples)
    except (CalibrationError, ValueError):
        return None
    before, after = refinement.before.systematic_px, refinement.after.systematic_px
    if before < WORTH_PX or after > _GAIN * before or not refinement.better:
        note = f"all pixels of {len(phases)} views agree with the projector to {before:.3f} px (trinocular residual)"
        return ProjectorCheck(calibration, before, before, False, note)
    note = (
        f"the projector was refined from all pixels of {len(phases)} views: trinocular residual {before:.3f} px "
        f"before, {after:.3f} px after"
    )
    return ProjectorCheck(refinement.calibration, after, before, True, note)
