"""Points at the border of a surface: rejected where they are probably wrong, and given the sigma that they have.

A pixel at a border sees two surfaces, or is fitted from a window that straddles them. A quadratic logistic regression
of its figures gives the probability that the point is wrong, a linear one of the logarithm the variance of its error.
``python -m benchmarks.accuracy.border_model`` fits the coefficients to simulated images.
"""

from __future__ import annotations

from math import exp, log
from typing import Any

import numpy as np

from pipeline.common.jit import allocating_linked, linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.filter.border.border_figures import SLOTS, figures, figures_of
from pipeline.filter.border.border_model import FIGURES
from pipeline.filter.border.border_pixels import ROWS, pixels_of_band

_NO = np.uint8(0)
_LARGEST_LOG = np.float32(9.0)


def largest_odds(probability: float) -> np.float32:
    """The logarithm of the odds of a probability 0..1; infinite at 1, where nothing is rejected."""
    return np.float32(log(probability / (1 - probability)) if probability < 1 else np.inf)


@allocating_linked
def log_odds(x: Any, wrong: Any, out: Any) -> None:
    """Logarithms of the odds that points are wrong, (TILE,).

    Args:
        x: (n, TILE) standardised figures; wrong: (1 + n + n (n + 1) / 2,) coefficients.
    """
    inner = np.empty(TILE, np.float32)
    out[:] = wrong[0]
    at = 1 + FIGURES
    for k in range(FIGURES):
        inner[:] = wrong[1 + k]
        for other in range(k + 1):
            w = wrong[at]
            at += 1
            for m in range(TILE):
                inner[m] += w * x[other, m]
        for m in range(TILE):
            out[m] += x[k, m] * inner[m]


@linked
def log_variance(x: Any, spread: Any, out: Any) -> None:
    """Logarithms of the variance in units of that of the noise, (TILE,); ``spread``: (1 + 2 n,) coefficients."""
    out[:] = spread[0]
    for k in range(FIGURES):
        linear, square = spread[1 + k], spread[1 + FIGURES + k]
        for m in range(TILE):
            out[m] += x[k, m] * (linear + square * x[k, m])


@parallel_allocating
def border_test(
    band: int, planes: Any, losses: Any, stride: int, per_order: Any, model: Any, limit: Any, valid: Any, misfit: Any,
    sigma: Any,
) -> None:  # fmt: skip
    """Reject border points that are probably wrong, and give the others the standard deviation of their error.

    Args:
        band: number of ROWS rows; planes: of :mod:`pipeline.filter.border.border_figures`; losses: by deviation.
        per_order: change of 1 / z from one order to the next, 1 / mm.
        model: ``BorderModel``; limit: log odds above which a point is rejected.
        valid: (H, W) uint8, changed; misfit: (H, W) uint8, set to 0 where ``sigma`` (stride H, stride W) is widened.
    """
    at = np.empty((ROWS * planes.label.shape[1] + 1, 2), np.int32)
    t, odds, more = np.empty(SLOTS * TILE, np.float32), np.empty(TILE, np.float32), np.empty(TILE, np.float32)
    x = figures_of(t)
    n = pixels_of_band(planes.label, planes.right_u, band, at)
    for start in range(0, n, TILE):
        some = at[start : min(start + TILE, n)]
        figures(planes, losses, stride, per_order, some, t)
        for k in range(FIGURES):
            mean, scale = model.mean[k], model.scale[k]
            for m in range(TILE):
                x[k, m] = (x[k, m] - mean) * scale
        log_odds(x, model.wrong, odds)
        log_variance(x, model.spread, more)
        for m in range(some.shape[0]):
            i, j = some[m, 0], some[m, 1]
            if valid[i, j] == 0:
                continue
            if odds[m] > limit:
                valid[i, j] = _NO
                continue
            misfit[i, j] = _NO
            factor = exp(np.float32(0.5) * min(max(more[m], np.float32(0.0)), _LARGEST_LOG))
            sigma[stride * i, stride * j] *= np.float32(factor)
