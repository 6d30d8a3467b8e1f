"""Cramer-Rao bound of the depth: the least error that the samples' noise allows each pixel by itself.

Three samples of a three-chip pixel determine brightness, modulation and phase; the bound of the phase is the variance
of the samples carried through that inversion. An estimator that combines neighbouring pixels may stay below it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration, ColorModel
from sim.render.ground_truth import Truth
from sim.render.sensor import noise_variance
from sim.rig.optics import Optics

Array = NDArray[np.float64]

_QUANTISATION = 1 / 12
_SATURATED = 254


def phase_variance(image: NDArray[np.uint8], color: ColorModel, pattern: ColorFringe, optics: Optics) -> Array:
    """Least variance of the phase of each pixel (H, W, 3) of three-chip images, (H, W), rad^2.

    The samples stand for their expected values. NaN where one is saturated.
    """
    shifts = np.array(pattern.shifts)
    quadratures = np.linalg.inv(np.stack([np.ones(3), np.cos(shifts), -np.sin(shifts)], axis=1))[1:] @ color.unmix
    above = image.astype(np.float64) - color.black
    p, q = np.moveaxis(above @ quadratures.T, -1, 0)
    variance = noise_variance(above.astype(np.float32), optics) + _QUANTISATION
    with np.errstate(invalid="ignore", divide="ignore"):
        slopes = (p[..., None] * quadratures[1] - q[..., None] * quadratures[0]) / (p**2 + q**2)[..., None]
        total = np.sum(slopes**2 * variance, axis=-1)
    return np.asarray(np.where((image >= _SATURATED).any(axis=-1), np.nan, total))


def depth_bound_mm(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    truth: Truth,
    calibration: Calibration,
    pattern: ColorFringe,
    optics: Optics,
) -> Array:
    """Least standard deviation along the left camera's ray of each pixel's point, (H, W), mm; NaN where unknown.

    A depth error t moves the point's image in the right camera, where the phase changes by ``s`` per mm:
    variance (left phase + right phase) / s^2. ``s`` follows from the slopes of phase and place over the surface.

    Args:
        left, right: (H, W, 3) uint8; truth: of the left camera.
    """
    xyz = truth.xyz.astype(np.float64)
    column = truth.projector[..., 0 if pattern.axis == "x" else 1].astype(np.float64)
    phase = np.interp(column, np.arange(pattern.length), pattern.phase, left=np.nan, right=np.nan)
    centre = calibration.left.centre
    ray = xyz - centre
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    place = calibration.right.project(xyz.reshape(-1, 3)).reshape(*xyz.shape[:2], 2)
    moved = calibration.right.project((xyz + ray).reshape(-1, 3)).reshape(place.shape) - place
    with np.errstate(invalid="ignore", divide="ignore"):
        (u_y, u_x), (v_y, v_x), (f_y, f_x) = (np.gradient(each) for each in (place[..., 0], place[..., 1], phase))
        area = u_x * v_y - u_y * v_x
        by_u, by_v = (f_x * v_y - f_y * v_x) / area, (f_y * u_x - f_x * u_y) / area
        slope = by_u * moved[..., 0] + by_v * moved[..., 1]
        there = cv2.remap(
            phase_variance(right, calibration.right_color, pattern, optics),
            place[..., 0].astype(np.float32), place[..., 1].astype(np.float32), cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan,
        )  # fmt: skip
        here = phase_variance(left, calibration.left_color, pattern, optics)
        return np.asarray(np.sqrt(here + there) / np.abs(slope))
