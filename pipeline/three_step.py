"""The exact three-step solution of every pixel of a three-chip picture, before any window."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange


@parallel
def three_chip_pointwise(
    image: Any, solve: Any, black: Any, unmix: Any, clip: float, floor: float, gain: float
) -> tuple[Any, Any, Any, Any, Any]:
    """Exact three-step solution of every pixel.

    Args:
        image: (H, W, 3) uint8.
        solve: (3, 3) float32, counts minus black -> (A, C, S).
        black: (3,) float32 counts.
        unmix: (3, 3) float32, inverse crosstalk.
        clip: counts from which a sample is clipped.
        floor, gain: noise model, counts^2 and counts^2 per count.

    Returns:
        phasor (H, W) complex64; mean (H, W); corrected channels (H, W, 3); variance of the tangential part of the
        phasor (H, W), counts^2; number of clipped samples (H, W) uint8.
    """
    height, width = image.shape[:2]
    phasor = np.empty((height, width), np.complex64)
    mean = np.empty((height, width), np.float32)
    channels = np.empty((height, width, 3), np.float32)
    tangential = np.empty((height, width), np.float32)
    clipped = np.empty((height, width), np.uint8)
    for i in prange(height):
        for j in range(width):
            r, g, b = np.float32(image[i, j, 0]), np.float32(image[i, j, 1]), np.float32(image[i, j, 2])
            clipped[i, j] = (r >= clip) + (g >= clip) + (b >= clip)
            x, y, z = r - black[0], g - black[1], b - black[2]
            for k in range(3):
                channels[i, j, k] = unmix[k, 0] * x + unmix[k, 1] * y + unmix[k, 2] * z
            mean[i, j] = max(solve[0, 0] * x + solve[0, 1] * y + solve[0, 2] * z, np.float32(0.0))
            c = solve[1, 0] * x + solve[1, 1] * y + solve[1, 2] * z
            s = solve[2, 0] * x + solve[2, 1] * y + solve[2, 2] * z
            phasor[i, j] = complex(c, s)
            norm = c * c + s * s + np.float32(1e-6)
            total = np.float32(0.0)
            for k in range(3):
                t = solve[2, k] * c - solve[1, k] * s
                level = x if k == 0 else (y if k == 1 else z)
                total += t * t * (floor + gain * max(level, np.float32(0.0)))
            tangential[i, j] = total / norm
    return phasor, mean, channels, tangential, clipped
