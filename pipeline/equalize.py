"""The equalised phase: each channel divided by its own local mean over about one fringe period.

A coloured surface answers the three fringes unequally, which bends the pointwise phase (half a radian on a coloured
head). Dividing each channel by its mean over one period takes that away; it serves the choice of the fringe order,
where a bias costs, not the sub-pixel match, where it is the same in both cameras and cancels.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.kernels import parallel, prange

F32 = NDArray[np.float32]
_ACROSS = 5  # extent of the mean across the direction of growth, pixels


def local_means(channels: F32, period_px: float, *, axis: str) -> F32:
    """Two-pass box mean of (H, W, 3) channels over one period along the axis of growth."""
    length = max(3, round(period_px))
    window = (length, _ACROSS) if axis == "x" else (_ACROSS, length)
    once = cv2.blur(channels, window, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.blur(once, window, borderType=cv2.BORDER_REFLECT), dtype=np.float32)


@parallel
def equalized_phasor(channels: Any, means: Any, solve: Any) -> Any:
    """Phasor of the channels divided by their means; ``solve`` (3, 3) gives (A, C, S) without crosstalk.

    Returns:
        (H, W) complex64, about unit size for full modulation.
    """
    height, width = channels.shape[:2]
    out = np.empty((height, width), np.complex64)
    for i in prange(height):
        for j in range(width):
            r = channels[i, j, 0] / max(means[i, j, 0], np.float32(1.0))
            g = channels[i, j, 1] / max(means[i, j, 1], np.float32(1.0))
            b = channels[i, j, 2] / max(means[i, j, 2], np.float32(1.0))
            c = solve[1, 0] * r + solve[1, 1] * g + solve[1, 2] * b
            s = solve[2, 0] * r + solve[2, 1] * g + solve[2, 2] * b
            out[i, j] = complex(c, s)
    return out
