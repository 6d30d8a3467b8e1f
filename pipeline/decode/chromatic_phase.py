"""Chromatic phase correction: the phase angles that lateral chromatic aberration and registration give each channel.

Light of channel c at pixel x is displaced by d_c(x) against green light, and the projector emits it s_c beside its
column. Both shift the phase of the channel's fringe by ``eps_c = Phi(P(x - d_c) - s_c) - Phi(P(x))``, where P is the
projector coordinate that the pixel observes. P depends on the depth, eps_c hardly does: the middle of the volume
serves, and the mean slope of a frequency-modulated fringe.

With shifted fringes the solution (A', C', S') of the uncorrected equations is F (A, C, S), a matrix for every pixel:
``F = L(delta)^-1 L(delta + eps)`` with the rows ``L_c(delta) = (1, cos delta_c, -sin delta_c)``. The mean of eps over
the image is added to the decoder's shifts at no cost; the rest becomes a table of every 16th row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration, ColorModel

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Triple = tuple[float, float, float]

STEP = 16
SMALLEST_RAD = 1e-3
"""Angles that differ less than this over the image are taken as constant."""


@dataclass(frozen=True, slots=True, eq=False)
class ChromaticCorrection:
    """Phase correction of the three channels of one camera, as the decoder takes it.

    Args:
        shifts: of the pattern's channels with the constant part of the angles, radians.
        table: (n, 12, W) float32 for rows 0, step, 2 step ...: last two columns of F, (3, 2) by rows, then those of its
            inverse.
        step: rows from one to the next; 0 = nothing to correct, and the table is a dummy.
    """

    shifts: Triple
    table: F32
    step: int

    @staticmethod
    def none(shifts: Triple) -> ChromaticCorrection:
        """No correction."""
        return ChromaticCorrection(shifts, np.zeros((2, 12, 1), np.float32), 0)

    @staticmethod
    def of(shifts: Triple, angles: F64) -> ChromaticCorrection:
        """From the channels' angles at every STEP-th row, (3, n, W), the last of them below the image."""
        constant = angles.mean(axis=(1, 2))
        red, green, blue = (float(s) for s in np.array(shifts) + constant)
        rest = np.moveaxis(angles - constant[:, None, None], 0, -1)
        if np.abs(rest).max() < SMALLEST_RAD:
            return ChromaticCorrection.none((red, green, blue))
        base = np.array([red, green, blue])
        full = np.linalg.inv(_light(base)) @ _light(base + rest)
        both = np.stack([full[..., 1:], np.linalg.inv(full)[..., 1:]], axis=-3)
        table = np.moveaxis(both.reshape(*rest.shape[:2], 12), 1, 2)
        return ChromaticCorrection((red, green, blue), np.ascontiguousarray(table, np.float32), STEP)


def chromatic_correction(
    calibration: Calibration, pattern: ColorFringe, color: ColorModel, depth_mm: float
) -> ChromaticCorrection:
    """The left camera's table for a pattern (pass ``calibration.swapped()`` for the right one).

    Args:
        color: of that camera; depth_mm: middle of the volume along its axis.
    """
    if color.lateral_chromatic is None and calibration.registration is None:
        return ChromaticCorrection.none(pattern.shifts)
    width, height = calibration.left.size
    rows = STEP * np.arange((height - 1) // STEP + 2, dtype=np.float64)
    v, u = np.meshgrid(rows, np.arange(width, dtype=np.float64), indexing="ij")
    angles = channel_angles(calibration, pattern, color, depth_mm, np.stack([u, v], axis=-1))
    return ChromaticCorrection.of(pattern.shifts, angles)


def channel_angles(
    calibration: Calibration, pattern: ColorFringe, color: ColorModel, depth_mm: float, pixels: F64
) -> F64:  # fmt: skip
    """Angles of red, green and blue at pixels of the left camera, (..., 2) -> (3, ...), radians."""
    camera, projector = calibration.left, calibration.projector
    first = 0 if pattern.axis == "x" else 1
    size, slope = projector.size, (pattern.phase[-1] - pattern.phase[0]) / (pattern.length - 1)

    def projector_pixels(at: F64) -> F64:
        rays = camera.normalise(at)
        return projector.project(np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1) * depth_mm)

    reference = projector_pixels(pixels)
    displacement = (
        np.zeros((3, *pixels.shape)) if color.lateral_chromatic is None else color.lateral_chromatic.at(camera, pixels)
    )
    angles = []
    for k in range(3):
        pixel = projector_pixels(pixels - displacement[k])
        if calibration.registration is not None:
            pixel = pixel - calibration.registration.at(size, pixel)[k]
        angles.append(slope * (pixel - reference)[..., first])
    return np.nan_to_num(np.stack(angles))


def _light(delta: F64) -> F64:
    """Rows (1, cos, -sin) of the channels, (..., 3) -> (..., 3, 3)."""
    return np.stack([np.ones_like(delta), np.cos(delta), -np.sin(delta)], axis=-1)
