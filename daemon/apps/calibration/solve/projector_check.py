"""The last look at a calibrated projector: do all pixels of the board agree with it, not just the marks?

Every white pixel that both cameras see gives a point from the two cameras alone, and the projector coordinates that
were observed there. What they differ by from the calibrated projector is the trinocular residual. How well the board
was printed plays no part in it. Where it shows the projector wrong by more than the marks can have noticed, the
projector is refined; the left and the right camera, which the metric comes from, stay.
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
"""Systematic residual from which on the projector is refined."""
_GAIN = 0.5


@dataclass(frozen=True, slots=True)
class Trinocular:
    """What all pixels say.

    Args:
        calibration: with the projector refined, or as it was.
        residual_px: systematic part of observed minus predicted projector pixels that is left.
        before_px: the same as it was found.
        refined: whether the projector was changed; note: a sentence for the report.
    """

    calibration: Calibration
    residual_px: float
    before_px: float
    refined: bool
    note: str


def last_look(calibration: Calibration, phases: Sequence[tuple[Phases, Phases]]) -> Trinocular | None:
    """Judge the projector by all pixels of some views, and refine it if they say so; None where they say nothing."""
    try:
        samples = joined(*(samples_of_phases(calibration, left, right) for left, right in phases))
        found = refine_projector(calibration, samples)
    except (CalibrationError, ValueError):
        return None
    before, after = found.before.systematic_px, found.after.systematic_px
    if before < WORTH_PX or after > _GAIN * before or not found.better:
        note = f"all pixels of {len(phases)} views agree with the projector to {before:.3f} px (trinocular residual)"
        return Trinocular(calibration, before, before, False, note)
    note = (
        f"the projector was refined from all pixels of {len(phases)} views: trinocular residual {before:.3f} px, "
        f"then {after:.3f} px"
    )
    return Trinocular(found.calibration, after, before, True, note)
