"""Options of a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from pipeline.common.errors import CalibrationError

Loss = Literal["huber", "cauchy", "squared"]


@dataclass(frozen=True, slots=True)
class Options:
    """Options of :func:`pipeline.calibrate.bundle.calibrate`.

    Args:
        skew: whether the skew of each device is estimated; else it keeps its start value (0 without one). Free by
            default: it hardly raises the other parameters' uncertainty, and a real skew that is not modelled (axes of
            a projector's optics, a tilted sensor) would leave systematic residuals; its standard deviation shows
            whether it is significant.
        k3: whether the third radial coefficient is estimated.
        tangential: whether p1 and p2 are estimated.
        aspect: fixed fy / fx, or None: both focal lengths are estimated.
        fixed: parameters held at their start values, as ``right.k3``, or whole devices, as ``right``.
        loss: of a residual in units of its standard deviation; ``squared`` is plain least squares.
        loss_scale: residual, in standard deviations, from where on the loss grows more slowly than the square.
        board_refined: estimate the marks' positions on the board, too (Strobl and Hirzinger, 2011; Albarelli et al.,
            2009). Each mark must have the same number in all views: do not turn a symmetric board upside down. The
            scale stays that of the mean pitch over the whole board, unless a known distance is given.
        known_distance: (mark, mark, mm), a distance on the board measured with a ruler: fixes the scale of everything.
        mark_limit: a mark is rejected when its residual is more than this many standard deviations.
        view_limit: a view is rejected when its rms residual is more than this many times the median one.
        most_marks, most_views: largest shares of the marks and of the views that may be rejected.
        least_views: fewest views that are accepted.
        least_marks: fewest marks of one device in one view; with less the device's image is rejected.
        most_focal_sigma: largest standard deviation of a focal length, as a share of it.
        most_centre_sigma: largest standard deviation of a principal point, as a share of the image's width.
        check: whether a degenerate set of views is an error; a guided session calibrates incomplete sets, too.
    """

    skew: bool = True
    k3: bool = True
    tangential: bool = True
    aspect: float | None = None
    fixed: tuple[str, ...] = ()
    loss: Loss = "huber"
    loss_scale: float = 3.0
    board_refined: bool = False
    known_distance: tuple[int, int, float] | None = None
    mark_limit: float = 5.0
    view_limit: float = 3.0
    most_marks: float = 0.1
    most_views: float = 0.34
    least_views: int = 3
    least_marks: int = 8
    most_focal_sigma: float = 3e-3
    most_centre_sigma: float = 1e-2
    check: bool = True

    def __post_init__(self) -> None:
        if self.loss not in get_args(Loss):
            raise CalibrationError(f"loss {self.loss!r}: expected one of {', '.join(get_args(Loss))}")
        if self.aspect is not None and not 0.1 < self.aspect < 10:
            raise CalibrationError(f"aspect {self.aspect}: expected fy / fx between 0.1 and 10")
        for key, least in (("loss_scale", 0.1), ("mark_limit", 3.0), ("view_limit", 1.5)):
            if not getattr(self, key) >= least:
                raise CalibrationError(f"{key} {getattr(self, key)}: expected at least {least}")
        for key in ("most_marks", "most_views"):
            if not 0 <= getattr(self, key) < 1:
                raise CalibrationError(f"{key} {getattr(self, key)}: expected a share from 0 to less than 1")
        if self.least_views < 2 or self.least_marks < 6:
            raise CalibrationError(
                f"least_views {self.least_views}, least_marks {self.least_marks}: expected at least 2 and 6"
            )
        if self.known_distance is not None and not 0 < self.known_distance[2] < 1e6:
            raise CalibrationError(f"known_distance {self.known_distance[2]} mm: expected more than 0 mm")
