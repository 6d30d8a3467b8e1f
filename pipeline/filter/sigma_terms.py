"""What adds to the noise in the standard deviation of a point: textures that differ, and the bias of coloured surfaces.

The phase error of a surface whose channels reflect unequally is nearly the same in both cameras, and cancels but for
the difference of their windows and samplings; so does the texture's. The shares that remain were measured on simulated
scenes: the mean square of the errors without noise over the square of the bias, and of the misfit.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel
from pipeline.filter.texture_agreement import MISFIT_STEPS
from pipeline.match.match_result import RESIDUAL_STEP


class Shares(NamedTuple):
    """Shares of the squares of bias and misfit that remain in the difference of both phases."""

    bias: float
    misfit: float


THREE_CHIPS, MOSAIC = Shares(0.0007, 0.08), Shares(0.004, 0.3)
"""A mosaic's window is larger, and its samples are of different colours."""
SATURATED, FEW_SATURATED = 3.0, 0.05
"""Factor of the bias where channels are cut off, and the share of saturated pixels from which it holds."""


def shares_of(*, mosaic: bool, saturated: float) -> Shares:
    """Shares of a pair, ``saturated``: share of its pixels with a saturated sample."""
    kind = MOSAIC if mosaic else THREE_CHIPS
    return kind._replace(bias=kind.bias * (1 + (SATURATED - 1) * min(saturated / FEW_SATURATED, 1.0)))


@serial
def _widen_row(
    misfit: Any, normalised: Any, residual: Any, variance: Any, bias_share: Any, misfit_share: Any, sigma: Any
) -> None:  # fmt: skip
    one = np.float32(1.0)
    for j in range(misfit.shape[0]):
        e, b = np.float32(misfit[j]), np.float32(normalised[j]) - np.float32(residual[j])
        more = bias_share * b * b + misfit_share * e * e
        sigma[j] *= np.float32(sqrt(one + more / variance[j]))


@parallel
def widen_sigma(
    i: int, misfit: Any, normalised: Any, residual: Any, variance: Any, shares: Any, stride: int, sigma: Any
) -> None:  # fmt: skip
    """Add the remaining errors to the standard deviation of the points.

    Args:
        misfit: (h, w) uint8, see :class:`pipeline.filter.texture_agreement.Agreement`.
        normalised, residual: (h, w) int16 of :class:`pipeline.match.match_result.MatchResult`; they differ by the bias.
        variance: (h, w) float32, rad^2, of the left phase; the right one's is alike.
        shares: :class:`Shares`.
        stride: pixel (a, b) of those is that at (stride a, stride b) of ``sigma`` (H, W) float32, which is changed;
            where there is no point it may become anything.
    """
    bias = np.float32(0.5 * shares.bias * RESIDUAL_STEP**2)
    mis = np.float32(0.5 * shares.misfit / MISFIT_STEPS**2)
    if stride == 1:
        _widen_row(misfit[i], normalised[i], residual[i], variance[i], bias, mis, sigma[i])
    else:
        _widen_row(misfit[i], normalised[i], residual[i], variance[i], bias, mis, sigma[stride * i, ::stride])
