"""Scores of a cloud against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.render.ground_truth import Truth

RIGHT_MM = 1.0
WRONG_MM = 6.0
Array = NDArray[np.float64]
_LEAST_POINTS = 100
# Tukey's limit in medians of the error's length: 5 standard deviations of errors along one axis are 7.4 of them.
_TUKEY, _ALIGNMENT_ROUNDS = 7.4, 20


@dataclass(frozen=True, slots=True)
class Score:
    """Figures of merit of one cloud.

    Args:
        reconstructed: share of the pixels that are lit and seen by both cameras whose point errs by less than 1 mm.
        wrong: share of the points that err by more than 6 mm, or have no truth.
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
    """Score a cloud (H, W, 3) mm; ``only`` (H, W) restricts the accuracy figures to a part of the image."""
    error = np.linalg.norm(xyz.astype(np.float64) - truth.xyz, axis=-1)
    valid = np.isfinite(xyz[..., 2])
    scorable = truth.scorable
    with np.errstate(invalid="ignore"):
        right = valid & (error < RIGHT_MM)
        wrong = valid & ~(error <= WRONG_MM)
    used = right if only is None else right & only
    smooth = smoothed_error(xyz, truth, right)
    smooth = smooth[np.isfinite(smooth) & (True if only is None else only)]
    return Score(
        reconstructed=float((right & scorable).sum() / max(1, scorable.sum())),
        wrong=float(wrong.sum() / max(1, valid.sum())),
        rms_mm=float(np.sqrt(np.mean(error[used] ** 2))) if used.any() else float("nan"),
        smooth_rms_mm=float(np.sqrt(np.mean(smooth**2))) if smooth.size else float("nan"),
        bias_mm=float(smooth.mean()) if smooth.size else float("nan"),
        points=int(valid.sum()),
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


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The rigid motion that aligns a cloud with the truth: ``X_true = rotation X + translation``.

    Args:
        rotation: (3, 3); translation: (3,), mm.
        angle_deg: of the rotation.
        shift_mm: how far the middle of the cloud moves.
        scale: of the cloud, that would fit best, 1 = none. It is reported, not applied: a wrong scale is an error.
    """

    rotation: Array
    translation: Array
    angle_deg: float
    shift_mm: float
    scale: float

    def applied(self, xyz: NDArray[np.float32]) -> NDArray[np.float32]:
        """A cloud (..., 3) after the motion."""
        return np.asarray(xyz.astype(np.float64) @ self.rotation.T + self.translation, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class AlignedScore:
    """Score of a cloud aligned with the truth, and the alignment."""

    score: Score
    alignment: Alignment


def aligned(xyz: NDArray[np.float32], truth: Truth, *, only: NDArray[np.bool_] | None = None) -> AlignedScore:
    """Score the shape of a cloud measured with any calibration of the same left camera.

    A calibration's world is its own left camera, which differs from the true one by what the calibration cannot
    determine (principal point against rotation, for instance). The whole cloud is moved rigidly, never scaled, to the
    best fit, and then scored: what remains is error of shape and size. The fit compares pixel by pixel, so a shift
    along a surface counts as error.

    Args:
        xyz: (H, W, 3) mm in the frame of the calibration. truth: of the true left camera. only: see :func:`score`.

    Raises:
        ValueError: fewer than 100 points have a truth.
    """
    alignment = best_motion(xyz, truth)
    return AlignedScore(score(alignment.applied(xyz), truth, only=only), alignment)


def best_motion(xyz: NDArray[np.float32], truth: Truth) -> Alignment:
    """The rigid motion of a cloud to the truth (Kabsch, 1976), with Tukey's weights against wrong points."""
    both = np.isfinite(xyz[..., 2]) & truth.hit
    if np.count_nonzero(both) < _LEAST_POINTS:
        raise ValueError(
            f"{np.count_nonzero(both)} points have a truth, expected {_LEAST_POINTS} or more to align them"
        )
    cloud, true = xyz[both].astype(np.float64), truth.xyz[both].astype(np.float64)
    offset = true - cloud
    rotation, translation = np.eye(3), np.median(offset, axis=0)
    scale = 1.0
    for _ in range(_ALIGNMENT_ROUNDS):
        error = np.linalg.norm(cloud @ rotation.T + translation - true, axis=1)
        limit = _TUKEY * max(float(np.median(error)), 1e-6)
        weights = np.clip(1 - (error / limit) ** 2, 0, None) ** 2
        rotation, translation, scale = _kabsch(cloud, true, weights)
    middle = cloud.mean(axis=0)
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))
    shift = np.linalg.norm(rotation @ middle + translation - middle)
    return Alignment(rotation, translation, float(angle), float(shift), scale)


def _kabsch(cloud: Array, true: Array, weights: Array) -> tuple[Array, Array, float]:
    share = (weights / weights.sum())[:, None]
    middle, target = (share * cloud).sum(axis=0), (share * true).sum(axis=0)
    centred, centred_true = cloud - middle, true - target
    u, values, vt = np.linalg.svd((share * centred_true).T @ centred)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((values * sign).sum() / (share * centred * centred).sum())
    return rotation, target - rotation @ middle, scale
