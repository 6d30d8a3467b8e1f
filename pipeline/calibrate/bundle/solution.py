"""The result of a calibration: values, uncertainties, residuals and rejections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Rejection:
    """A rejected or repaired image, view or mark.

    Args:
        view: its name.
        device: ``left``, ``right``, ``projector``; empty: the whole view.
        ids: numbers of the marks, as the user numbered them; empty: all of them.
        reason: a sentence with the numbers that decided.
        repaired: the marks are used, with another numbering.
    """

    view: str
    device: str
    ids: tuple[int, ...]
    reason: str
    repaired: bool = False

    def __str__(self) -> str:
        where = f"{self.view}, {self.device}" if self.device else self.view
        marks = f", marks {', '.join(map(str, self.ids))}" if self.ids else ""
        return f"{where}{marks}: {self.reason}"


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Measured minus predicted of one image's used marks.

    Args:
        ids: (n,) numbers of the marks.
        pixels: (n, 2) where they were detected.
        misfit: (n, 2) px.
        sigma: (n,) standard deviation of a coordinate that the adjustment gave them, px.
    """

    ids: Index
    pixels: Array
    misfit: Array
    sigma: Array


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A joint calibration; the world is the left camera's frame.

    Args:
        devices: by name, the first at the identity.
        poses: (R, t), board to world, of every view; None for rejected views.
        views: names of all views, in the order given.
        sigma: standard deviation by name: ``left.fx`` (px), ``right.k1``, ``right.rotation_x`` (radians, a
            component of the rotation vector), ``right.translation_x`` (mm), and of the derived ``baseline_mm``,
            ``angle_deg``, ``projector.baseline_mm``, ``projector.angle_deg``. Held parameters have 0.
        values: the same names and their values.
        covariance: (p, p) of ``names``, the poses of the boards marginalised.
        names: of the rows of ``covariance``.
        residuals: by (view's name, device).
        rejected: rejections and repairs with their reasons.
        rms: reprojection error by device, px: root of the mean squared distance, as OpenCV counts.
        rms_stereo: the same over both cameras (over all devices' marks without a right camera).
        sigma0: by device, the noise of a coordinate in the residuals over the expected one.
        noise_px: by device, standard deviation of one coordinate in the residuals.
        epipolar_px: mean distance of undistorted points from their partners' epipolar lines; NaN with one camera.
        baseline_mm, angle_deg: left to right, and between their axes; NaN with one camera.
        board_points: (n, 3) mm, refined if that is chosen.
        diameter_mm: of the circles; 0 where the marks are points.
        views_used, views_rejected: counts.
        offsets_px: largest correction from a circle's centre to its image's centroid.
        steps: of the last search.
        scale: text on what fixes the scale of the world.
        board_sigma_mm: (n, 3) standard deviations of refined board points.
        sigma_calibration_mm: standard deviation of measured depths from the cameras' parameters; NaN with one camera.
    """

    devices: dict[str, CameraModel]
    poses: list[tuple[Array, Array] | None]
    views: tuple[str, ...]
    sigma: dict[str, float]
    values: dict[str, float]
    covariance: Array
    names: tuple[str, ...]
    residuals: dict[tuple[str, str], Residuals]
    rejected: tuple[Rejection, ...]
    rms: dict[str, float]
    rms_stereo: float
    sigma0: dict[str, float]
    noise_px: dict[str, float]
    epipolar_px: float
    baseline_mm: float
    angle_deg: float
    board_points: Array
    diameter_mm: float
    views_used: int
    views_rejected: int
    offsets_px: float
    steps: int
    scale: str
    board_sigma_mm: Array | None = None
    sigma_calibration_mm: float = float("nan")

    def quality(self) -> dict[str, float | int]:
        """The figures for the ``quality`` part of a calibration file."""
        result: dict[str, float | int] = {f"rms_{name}_px": round(value, 4) for name, value in self.rms.items()}
        result["rms_stereo_px"] = round(self.rms_stereo, 4)
        if np.isfinite(self.epipolar_px):
            result["epipolar_px"] = round(self.epipolar_px, 4)
        if np.isfinite(self.sigma_calibration_mm):
            result["sigma_calibration_mm"] = round(self.sigma_calibration_mm, 4)
        result["views_used"], result["views_rejected"] = self.views_used, self.views_rejected
        return result
