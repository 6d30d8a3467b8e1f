"""Limits of the absolute phase on each pixel's ray inside the measuring volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.ray_tables import DepthScale, ray_table
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
_STEP = 8


@dataclass(frozen=True, slots=True, eq=False)
class PhaseLimits:
    """Limits of the absolute phase of every pixel of one camera, (H, W) float32, radians; size: (W, H)."""

    size: tuple[int, int]
    low: F32
    high: F32

    @staticmethod
    def of(
        calibration: Calibration, volume: Volume, *, axis: str, per_px: float, margin_px: float,
        inside: tuple[CameraModel, Volume] | None = None,
    ) -> PhaseLimits:  # fmt: skip
        """For the calibration's left camera.

        Args:
            per_px: radians per projector pixel; margin_px: uncertainty of the projector, projector pixels.
            inside: the camera along whose axis the volume is given, see :func:`pipeline.geometry.ray_tables.ray_table`.
        """
        depth = DepthScale.of(volume)
        table = ray_table(calibration, depth, axis=axis, step=(_STEP, _STEP), margin=0, inside=inside)
        along = table.along.astype(np.float64)
        ends = np.sort(
            [(along[0] + along[1] * s) / (1 + along[2] * s) for s in table.limits.astype(np.float64)], axis=0
        )
        width, height = calibration.left.size
        low, high = (_everywhere(end, height, width) for end in (ends[0] - margin_px, ends[1] + margin_px))
        length = calibration.projector.size[0 if axis == "x" else 1]
        low, high = np.maximum(low, -0.5), np.minimum(high, length - 0.5)
        return PhaseLimits((width, height), *(((end + 0.5) * per_px).astype(np.float32) for end in (low, high)))


def _everywhere(lattice: F64, height: int, width: int) -> F64:
    """A lattice's values, interpolated linearly at all pixels."""
    rows, columns = (_weights(n, m) for n, m in zip((height, width), lattice.shape, strict=True))
    return np.asarray(rows @ lattice @ columns.T)


def _weights(pixels: int, nodes: int) -> F64:
    """(pixels, nodes): weight of each node in each pixel; linear extrapolation beyond the last one."""
    place = np.arange(pixels) / _STEP
    cell = np.clip(place.astype(int), 0, max(nodes - 2, 0))
    part = place - cell
    out = np.zeros((pixels, nodes))
    out[np.arange(pixels), cell] = 1 - part
    out[np.arange(pixels), np.minimum(cell + 1, nodes - 1)] += part
    return out
