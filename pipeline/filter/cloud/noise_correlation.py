"""Correlation of neighbouring points' noise: phases are fitted in windows that overlap.

The mean of n points with independent noise has 1/sqrt(n) of their standard deviation. Noise that passed a window with
the weights g has the autocorrelation of g, and a mean with weights w has the variance sum_ij w_i w_j rho(i - j).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.decode.kernels.window_fit import weights_of

F64 = NDArray[np.float64]


def autocorrelation(radius: int, sigma: float) -> F64:
    """Correlation of two pixels' noise by their distance, (2 m + 1, 2 m + 1), m = 2 radius; its middle is 1.

    Args:
        radius, sigma: of the window of the phase fit, pixels; radius 0: independent noise.
    """
    line = weights_of(radius, sigma)[radius].astype(np.float64)
    one = np.convolve(line, line[::-1])
    return np.outer(one, one) / one.max() ** 2


def inflation(weights: F64, correlation: F64) -> float:
    """Variance of a weighted mean over that with independent noise: w' rho w / w'w.

    Args:
        weights: (k, k); correlation: of :func:`autocorrelation`.
    """
    total, reach = 0.0, correlation.shape[0] // 2
    height, width = weights.shape
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            if abs(dy) < height and abs(dx) < width:
                a = weights[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)]
                b = weights[max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)]
                total += correlation[reach + dy, reach + dx] * float((a * b).sum())
    return total / float((weights**2).sum())
