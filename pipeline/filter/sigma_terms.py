"""What adds to the noise in the standard deviation of a point: textures that differ, and the bias of coloured surfaces.

The phase error of a surface whose channels reflect unequally is nearly the same in both cameras, and cancels but for
the difference of their windows and samplings; so does the texture's, and the error of fringes that are no sines or cut
off. The shares that remain were measured on simulated scenes: the mean square of the errors without noise over the
square of the bias, of the misfit, and of the scatter of the phase against the projector's.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel
from pipeline.filter.texture_agreement import MISFIT_STEPS
from pipeline.match.match_result import RESIDUAL_STEP, MatchResult


class Shares(NamedTuple):
    """Shares of the squares of bias and misfit that remain in the difference of both phases, and a variance, rad^2."""

    bias: float
    misfit: float
    variance: float = 0.0


class _Scatter(NamedTuple):
    """Variance of the phase against the projector that textures cause, rad^2, and how many times the phase's noise."""

    texture: float
    noise: float


THREE_CHIPS, MOSAIC = Shares(0.0007, 0.08), Shares(0.004, 0.3)
"""A mosaic's window is larger, and its samples are of different colours."""
_THREE_CHIPS, _MOSAIC = _Scatter(0.05**2, 16.0), _Scatter(0.1**2, 12.0)
_SCATTER_SHARE = 0.012
_SAMPLES = 7000
_LEAST_SAMPLES = 200
SATURATED, FEW_SATURATED = 3.0, 0.05
"""Factor of the bias where channels are cut off, and the share of saturated pixels from which it holds."""


def shares_of(
    match: MatchResult, variance: Any, *, slopes: tuple[float, float], mosaic: bool, saturated: float
) -> Shares:
    """Shares of a pair.

    Args:
        variance: (H, W) rad^2, of the left phase; slopes: expected phase steps per pixel (x, y), one of them 0.
        saturated: share of the pair's pixels with a saturated sample.
    """
    kind, usual = (MOSAIC, _MOSAIC) if mosaic else (THREE_CHIPS, _THREE_CHIPS)
    scatter, noise = _scatter(match, variance, slopes)
    return Shares(
        kind.bias * (1 + (SATURATED - 1) * min(saturated / FEW_SATURATED, 1.0)),
        kind.misfit,
        _SCATTER_SHARE * max(scatter - usual.texture - usual.noise * noise, 0.0),
    )


def _scatter(match: MatchResult, variance: Any, slopes: tuple[float, float]) -> tuple[float, float]:
    """Variance of the difference of the normalised residuals of pixels half a period apart, and of the phase, rad^2."""
    lag = max(1, round(np.pi / max(abs(slopes[0]), abs(slopes[1]))))
    step = max(1, round((match.valid.size / _SAMPLES) ** 0.5))
    along = (slice(None), slice(lag, None)) if abs(slopes[0]) >= abs(slopes[1]) else (slice(lag, None), slice(None))
    here = tuple(slice(None, -lag) if part.start else part for part in along)
    grid = np.s_[::step, ::step]
    some = (match.valid[here][grid] != 0) & (match.valid[along][grid] != 0)
    if np.count_nonzero(some) < _LEAST_SAMPLES:
        return 0.0, 0.0
    ahead, behind = (match.residual_normalised[part][grid][some].astype(np.float32) for part in (along, here))
    spread = 1.4826 * float(np.median(np.abs(ahead - behind))) * RESIDUAL_STEP
    return spread**2, float(np.median(variance[here][grid][some]))


@serial
def _widen_row(
    misfit: Any, normalised: Any, residual: Any, variance: Any, bias_share: Any, misfit_share: Any, more: Any, sigma:
    Any,
) -> None:  # fmt: skip
    one = np.float32(1.0)
    for j in range(misfit.shape[0]):
        e, b = np.float32(misfit[j]), np.float32(normalised[j]) - np.float32(residual[j])
        sigma[j] *= np.float32(sqrt(one + (bias_share * b * b + misfit_share * e * e + more) / variance[j]))


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
    mis, more = np.float32(0.5 * shares.misfit / MISFIT_STEPS**2), np.float32(0.5 * shares.variance)
    if stride == 1:
        _widen_row(misfit[i], normalised[i], residual[i], variance[i], bias, mis, more, sigma[i])
    else:
        _widen_row(misfit[i], normalised[i], residual[i], variance[i], bias, mis, more, sigma[stride * i, ::stride])
