"""Observability of the parameters, by the covariance of the result."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.calibrate.bundle.options import Options
from pipeline.calibrate.bundle.quality.view_assessment import ViewAssessment, missing_views_text
from pipeline.calibrate.bundle.solution import Solution
from pipeline.common.errors import CalibrationError

_LEAST_NOISE_PX = 0.02
"""Lower bound of the noise: marks of few views can agree better by chance."""


def require_determined(
    solution: Solution, sizes: Mapping[str, tuple[int, int]], options: Options, assessment: ViewAssessment
) -> None:
    """Raise if a focal length or principal point is not determined well enough.

    Args:
        solution: the result.
        sizes: (width, height) by device.
        options: the limits.
        assessment: of the views, for the message.

    Raises:
        CalibrationError: with the parameter, its standard deviation, the limit, and what to add.
    """
    for name in solution.devices:
        grown = max(1.0, _LEAST_NOISE_PX / max(solution.noise_px[name], 1e-12))
        width = sizes[name][0]
        for key in ("fx", "fy", "cx", "cy"):
            sigma = solution.sigma[f"{name}.{key}"] * grown
            value = solution.values[f"{name}.{key}"]
            focal = key in ("fx", "fy")
            limit = options.most_focal_sigma * value if focal else options.most_centre_sigma * width
            if sigma > limit:
                what = "focal length" if focal else "principal point"
                raise CalibrationError(
                    f"the views do not determine the {what} of {name}: {key} {value:.1f} px has a standard deviation "
                    f"of {sigma:.2g} px (limit {limit:.2g} px); {missing_views_text(assessment)}"
                )
