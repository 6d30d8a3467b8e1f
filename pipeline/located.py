"""What the sub-pixel match knows of every left pixel, as separate planes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Located(NamedTuple):
    """Planes (H, W), float32 unless said; where ``known`` is False the others hold nothing meaningful.

    Args:
        known: bool, a match was found.
        depth_mm: along the left camera's z axis.
        sigma_mm: one standard deviation along the viewing ray.
        match_u, match_v: pixel of the right picture.
        source_u, source_v: projector pixel.
        residual_eq, residual: absolute phase minus the projector's phase at the point, equalised and pointwise, rad.
    """

    known: Any
    depth_mm: Any
    sigma_mm: Any
    match_u: Any
    match_v: Any
    source_u: Any
    source_v: Any
    residual_eq: Any
    residual: Any

    @staticmethod
    def empty(shape: tuple[int, int]) -> Located:
        """Planes to be written."""
        return Located(np.zeros(shape, np.bool_), *(np.zeros(shape, np.float32) for _ in range(8)))
