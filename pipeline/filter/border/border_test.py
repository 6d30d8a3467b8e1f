"""Points at the border of a surface: rejected where they are probably wrong, and given the sigma that they have.

A pixel at a border sees two surfaces, or is fitted from a window that straddles them. A quadratic logistic regression
of its figures gives the probability that the point is wrong, a linear one of the logarithm the variance of its error.
``python -m benchmarks.accuracy.border_model`` fits the coefficients to simulated images.

The limit of the probability is that of the image: the largest one with which the expected number of wrong points among
those that stay, the sum of their probabilities, is a stated share of all points. An image of narrow parts, whose
points are mostly at borders, has a lower limit than one of large surfaces.
"""

from __future__ import annotations

from math import exp, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import allocating_linked, linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.filter.border.border_figures import SLOTS, figures, figures_of
from pipeline.filter.border.border_model import FIGURES
from pipeline.filter.border.border_pixels import ROWS, pixels_of_band

_NO = np.uint8(0)
_LARGEST_LOG = np.float32(9.0)


EXPECTED_WRONG = 5e-4
"""Expected share of wrong border points in all points of an image."""
LEAST_LIMIT = 0.02
"""Probability up to which a point stays in every image."""
CODES = 128
"""Steps of the log odds, the first is that of pixels that are not at a border."""
_LEAST_ODDS, _PER_UNIT = np.float32(-6.0), np.float32(16.0)


def code_of(probability: float) -> int:
    """Largest code whose points are wrong with at most this probability, 0..1; all of them at 1."""
    if probability >= 1:
        return CODES - 1
    odds = log(probability / (1 - probability))
    return min(max(int((odds - float(_LEAST_ODDS)) * float(_PER_UNIT)), 0), CODES - 2)


def largest_code(expected: NDArray[np.float64], points: int, most: int) -> int:
    """Largest code of the points that stay.

    Args:
        expected: (bands, CODES) expected wrong points by code; points: of the image, all of them.
        most: largest code that stays in any image; with CODES - 1 all stay.
    """
    if most == CODES - 1:
        return most
    wrong = np.cumsum(expected.sum(axis=0)[1:])
    allowed = int(np.searchsorted(wrong, EXPECTED_WRONG * points, side="right"))
    return min(max(allowed, code_of(LEAST_LIMIT)), most)


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
    band: int, planes: Any, losses: Any, stride: int, per_order: Any, model: Any, valid: Any, misfit: Any, sigma: Any,
    code: Any, expected: Any,
) -> None:  # fmt: skip
    """Give border points codes of the odds that they are wrong, and the standard deviation of their error.

    Args:
        band: number of ROWS rows; planes: of :mod:`pipeline.filter.border.border_figures`; losses: by deviation.
        per_order: change of 1 / z from one order to the next, 1 / mm; model: ``BorderModel``.
        valid: (H, W) uint8; misfit: (H, W) uint8, set to 0 where ``sigma`` (stride H, stride W) is widened.
        code: (H, W) uint8, written, 0 where a point is not at a border or not valid.
        expected: (bands, CODES) float64, written: sums of the probabilities, by code.
    """
    at = np.empty((ROWS * planes.label.shape[1] + 1, 2), np.int32)
    t, odds, more = np.empty(SLOTS * TILE, np.float32), np.empty(TILE, np.float32), np.empty(TILE, np.float32)
    x = figures_of(t)
    code[band * ROWS : (band + 1) * ROWS] = _NO
    expected[band] = 0.0
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
            step = min(max((odds[m] - _LEAST_ODDS) * _PER_UNIT, np.float32(0.0)), np.float32(CODES - 2))
            code[i, j] = np.uint8(np.int32(step) + 1)
            expected[band, code[i, j]] += 1.0 / (1.0 + exp(-odds[m]))
            misfit[i, j] = _NO
            factor = exp(np.float32(0.5) * min(max(more[m], np.float32(0.0)), _LARGEST_LOG))
            sigma[stride * i, stride * j] *= np.float32(factor)
