"""The result of a detector."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.calibrate.targets.marks import Marks


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """The marks of one board in one image.

    Args:
        marks: see :class:`pipeline.calibrate.targets.marks.Marks`.
        sharpness_px: sigma of the Gaussian that blurs the marks' edges, pixels; the pixels' own aperture is part of it,
            so that about 0.5 is the sharpest there is.
        contrast: light minus dark over light, 0 to 1, median of the marks.
        saturated: share of the image's samples that are clipped, all colours counted.
    """

    marks: Marks
    sharpness_px: float
    contrast: float
    saturated: float
