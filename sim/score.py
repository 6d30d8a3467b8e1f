"""How good a cloud is, told by the truth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.truth import Truth

RIGHT_MM = 1.0
WRONG_MM = 6.0


@dataclass(frozen=True, slots=True)
class Score:
    """Figures of merit of one cloud.

    Args:
        reconstructed: share of the pixels that are lit and seen by both cameras whose point errs by less than 1 mm.
        wrong: share of the points that err by more than 6 mm, or stand where nothing is.
        rms_mm: root mean square error of the points that err by less than 1 mm.
        smooth_rms_mm: the same after a 5 x 5 local fit, away from borders.
        bias_mm: mean error along the viewing ray after the local fit, away from borders.
        points: number of points.
    """

    reconstructed: float
    wrong: float
    rms_mm: float
    smooth_rms_mm: float
    bias_mm: float
    points: int


def score(xyz: NDArray[np.float32], truth: Truth, *, only: NDArray[np.bool_] | None = None) -> Score:
    """Score a cloud (H, W, 3) mm; ``only`` (H, W) restricts the accuracy figures to a part of the picture."""
    error = np.linalg.norm(xyz.astype(np.float64) - truth.xyz, axis=-1)
    known = np.isfinite(xyz[..., 2])
    scorable = truth.scorable
    with np.errstate(invalid="ignore"):
        right = known & (error < RIGHT_MM)
        wrong = known & ~(error <= WRONG_MM)
    used = right if only is None else right & only
    smooth = smoothed_error(xyz, truth, right)
    smooth = smooth[np.isfinite(smooth) & (True if only is None else only)]
    return Score(
        reconstructed=float((right & scorable).sum() / max(1, scorable.sum())),
        wrong=float(wrong.sum() / max(1, known.sum())),
        rms_mm=float(np.sqrt(np.mean(error[used] ** 2))) if used.any() else float("nan"),
        smooth_rms_mm=float(np.sqrt(np.mean(smooth**2))) if smooth.size else float("nan"),
        bias_mm=float(smooth.mean()) if smooth.size else float("nan"),
        points=int(known.sum()),
    )


def smoothed_error(
    xyz: NDArray[np.float32], truth: Truth, right: NDArray[np.bool_], *, margin: int = 6
) -> NDArray[np.float64]:
    """Signed error along the ray, mm, after a 5 x 5 local plane fit; NaN near borders and where points are missing.

    The error of a smooth surface is itself smooth, so the value at the centre of a plane fitted to a symmetric window
    of it is the window's mean.
    """
    ray = np.linalg.norm(truth.xyz, axis=-1) / np.maximum(truth.xyz[..., 2], 1e-6)
    signed = np.where(right, (xyz[..., 2] - truth.xyz[..., 2]) * ray, 0.0).astype(np.float64)
    inner = cv2.erode(right.astype(np.uint8), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)) > 0
    return np.asarray(np.where(inner, cv2.blur(signed, (5, 5)), np.nan))
