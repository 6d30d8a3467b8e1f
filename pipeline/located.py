"""What the sub-pixel match hands to the gates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


class Located(NamedTuple):
    """Points of one pair before the gates, planes of (H, W) on the left camera's pixel grid.

    Where ``known`` is 0 the other planes hold anything, NaN and infinity included: they were never written.

    Args:
        known: uint8, 1 where a match was found, else 0 (bytes serve vector code better than truth values).
        depth_mm: along the left camera's z axis; sigma_mm: one standard deviation along the viewing ray.
        match_u, match_v: pixel in the right picture.
        source_u, source_v: pixel of the projector that lights the point.
        residual_eq, residual: absolute phase minus the projector's phase at the point, equalised and pointwise, radians.
    """

    known: NDArray[np.uint8]
    depth_mm: F32
    sigma_mm: F32
    match_u: F32
    match_v: F32
    source_u: F32
    source_v: F32
    residual_eq: F32
    residual: F32

    @staticmethod
    def empty(shape: tuple[int, int]) -> Located:
        """Planes to be written."""
        return Located(np.zeros(shape, np.uint8), *(np.empty(shape, np.float32) for _ in range(8)))
