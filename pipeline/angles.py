"""Wrapped angles inside vector loops: the library's arctan2 is a call for each element, this is a polynomial."""

from __future__ import annotations

import numpy as np

from pipeline.kernels import inline


@inline
def angle(c: float, s: float) -> float:
    """Angle of (c, s), float32 radians in [-pi, pi], to 4e-7; 0 for (0, 0)."""
    zero, x, y = np.float32(0.0), abs(c), abs(s)
    small, large = min(x, y), max(x, y)
    t = small / max(large, np.float32(1e-30))
    z = t * t
    # Smallest largest error of an odd polynomial with seven terms on [0, 1].
    p = np.float32(-0.0336042) + z * np.float32(0.00681179)
    p = np.float32(-0.13233341) + z * (np.float32(0.07962365) + z * p)
    p = np.float32(0.99999611) + z * (np.float32(-0.33317368) + z * (np.float32(0.19807815) + z * p))
    a = p * t
    a = np.float32(0.5 * np.pi) - a if y > x else a
    a = np.float32(np.pi) - a if c < zero else a
    return -a if s < zero else a
