"""The result of the sub-pixel match for the point filters.

The filters read several planes of a whole image many times, and memory bandwidth limits them: pixels and phases are
integers of 16 bits in steps that are fine enough for a filter. Only the cloud itself is float32.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]

PIXEL_STEPS = 8
"""Steps per pixel of a coordinate, counted from the image's edge: half a pixel before the first pixel's centre."""
OUTSIDE = np.uint16(65535)
"""Coordinate of what lies before the image's edge or beyond 8191 pixels."""
RESIDUAL_STEP = 0.005
"""Step of a residual, radians."""
LARGEST_RESIDUAL = 668
"""Steps at which residuals are cut off: the sum of 7 x 7 of them still has 16 bits."""
TURN_STEPS = 256
"""Steps per turn of the absolute phase, which is kept modulo 65536 steps (256 fringe orders)."""


class MatchResult(NamedTuple):
    """Points of one pair before the gates, planes of (H, W) on the left camera's pixel grid.

    Where ``valid`` is 0 the other planes hold anything, NaN and infinity included: they may never have been written.

    Args:
        valid: uint8, 1 where a match was found, else 0 (bytes serve vector code better than truth values).
        right_u, right_v: pixel in the right image, uint16 of :data:`PIXEL_STEPS`.
        projector_u, projector_v: pixel of the projector that lights the point, likewise.
        absolute_phase: phase of the left pixel and 2 pi times its order, int16 of :data:`TURN_STEPS`.
        residual_normalised, residual: absolute phase minus the projector's phase at the point, normalised and
            pointwise, int16 of :data:`RESIDUAL_STEP`.
    """

    valid: NDArray[np.uint8]
    right_u: U16
    right_v: U16
    projector_u: U16
    projector_v: U16
    absolute_phase: I16
    residual_normalised: I16
    residual: I16

    @staticmethod
    def empty(shape: tuple[int, int]) -> MatchResult:
        """Planes to be written."""
        right_u, right_v, projector_u, projector_v = (np.empty(shape, np.uint16) for _ in range(4))
        absolute_phase, residual_normalised, residual = (np.empty(shape, np.int16) for _ in range(3))
        valid = np.zeros(shape, np.uint8)
        return MatchResult(
            valid, right_u, right_v, projector_u, projector_v, absolute_phase, residual_normalised, residual
        )


class Points(NamedTuple):
    """What becomes the cloud: written by the match, taken back where the gates object.

    Args:
        xyz: (H, W, 3), mm; sigma_mm: (H, W), one standard deviation along the viewing ray.
    """

    xyz: F32
    sigma_mm: F32

    @staticmethod
    def empty(shape: tuple[int, int]) -> Points:
        """Planes to be written."""
        return Points(np.empty((*shape, 3), np.float32), np.empty(shape, np.float32))

    def depth_mm(self, stride: int) -> F32:
        """Of every n-th pixel of both axes, along the left camera's z axis."""
        return self.xyz[::stride, ::stride, 2]
