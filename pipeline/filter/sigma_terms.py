"""What adds to the noise in the standard deviation of a point: textures that differ, and the bias of coloured surfaces.

The phase error of a surface whose channels reflect unequally is nearly the same in both cameras, and cancels but for
the difference of their windows and samplings; so does the texture's, and the error of fringes that are no sines or cut
off. The shares that remain were measured on simulated scenes: the mean square of the errors without noise over the
square of the bias, of the misfit, and of the scatter of the phase against the projector's.

An inclined surface has narrower fringes in one image than in the other, and the blur leaves less of their modulation.
The bias is the channels' difference over the modulation: where the right image keeps the share t of the left one's, the
share 1 - t of the bias remains. A blur of standard deviation s px leaves exp(-s^2 f^2 / 2) of fringes of f radians per
pixel.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import linked
from pipeline.common.median import median
from pipeline.common.parallel_for import parallel_allocating
from pipeline.filter.texture_agreement import MISFIT_STEPS
from pipeline.match.match_result import PIXEL_STEPS, RESIDUAL_STEP, TURN_STEPS, MatchResult


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
_THREE_CHIPS, _MOSAIC = _Scatter(0.05**2, 16.0), _Scatter(0.06**2, 4.0)
_SCATTER_SHARE = 0.012
_PERIOD_PX = 10.7  # of the fringes whose scatter was measured
_SAMPLES = 7000
_LEAST_SAMPLES = 200
BLUR = 0.35
"""Half of the variance of the images' blur, px^2: optics, pixel area and the window of the decoding."""
ROWS = 8
"""Rows that share a scratch array."""
LAG = 2
"""Pixels to either side from which the fringes' frequency in both images is taken."""
_STEEPEST, _MOST_PERIODS = 0.2, 3.0  # right pixels per left pixel; frequency over the expected one
_FEWEST, _MOST = np.float32(-1.0), np.float32(3.4)  # where the fraction below stays within 0.1 of 1 - exp(-x)
SATURATED, FEW_SATURATED = 3.0, 0.05
"""Factor of the bias where channels are cut off, and the share of saturated pixels from which it holds."""


def shares_of(
    match: MatchResult, variance: Any, depth: Any, limits: tuple[np.float32, np.float32], *,
    slopes: tuple[float, float], mosaic: bool, saturated: float, corrected: float,
) -> Shares:  # fmt: skip
    """Shares of a pair.

    Args:
        variance: (H, W) rad^2, of the left phase; depth: (H, W) mm; limits: least and largest depth that counts.
        slopes: expected phase steps per pixel (x, y), one of them 0.
        saturated: share of the pair's pixels with a saturated sample.
        corrected: scatter that is missing because its cause is corrected in the normalised phase alone, rad^2.
    """
    kind, usual = (MOSAIC, _MOSAIC) if mosaic else (THREE_CHIPS, _THREE_CHIPS)
    scatter, noise = _scatter(match, variance, depth, limits, slopes)
    # The local means of the normalised phase span a period, over which a texture's change is proportional to it.
    longer = max(2 * np.pi / max(abs(slopes[0]), abs(slopes[1])) / _PERIOD_PX, 1.0)
    return Shares(
        kind.bias * (1 + (SATURATED - 1) * min(saturated / FEW_SATURATED, 1.0)),
        kind.misfit,
        _SCATTER_SHARE * max(scatter + corrected - longer**2 * usual.texture - usual.noise * noise, 0.0),
    )


def _scatter(
    match: MatchResult, variance: Any, depth: Any, limits: tuple[np.float32, np.float32], slopes: tuple[float, float]
) -> tuple[float, float]:
    """Variance of the difference of the normalised residuals of pixels half a period apart, and of the phase, rad^2."""
    lag = max(1, round(np.pi / max(abs(slopes[0]), abs(slopes[1]))))
    step = max(1, round((match.valid.size / _SAMPLES) ** 0.5))
    along = (slice(None), slice(lag, None)) if abs(slopes[0]) >= abs(slopes[1]) else (slice(lag, None), slice(None))
    here = tuple(slice(None, -lag) if part.start else part for part in along)
    grid = np.s_[::step, ::step]
    z = depth[here][grid]
    some = (match.valid[here][grid] != 0) & (match.valid[along][grid] != 0) & (z >= limits[0]) & (z <= limits[1])
    if np.count_nonzero(some) < _LEAST_SAMPLES:
        return 0.0, 0.0
    ahead, behind = (match.residual_normalised[part][grid][some].astype(np.float32) for part in (along, here))
    spread = 1.4826 * median(np.abs(ahead - behind)) * RESIDUAL_STEP
    return spread**2, median(variance[here][grid][some])


@linked
def _lost_row(known: Any, phase: Any, pixel: Any, slope: Any, stride: Any, out: Any) -> None:
    """Square of 1 - t of a row (n,), 0 where a neighbour is unknown or on another surface.

    Args:
        known, phase, pixel: the two neighbours' ``valid``, ``absolute_phase`` and right pixel along the fringes' axis.
        slope: expected phase steps in 2 ``LAG`` pixels; stride: of the pixels.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    radians = np.float32(BLUR * (2 * np.pi / TURN_STEPS) ** 2)
    left = one / np.float32((2 * LAG * stride) ** 2)
    least = np.float32(_STEEPEST * 2 * LAG * stride * PIXEL_STEPS)
    most = np.float32(_MOST_PERIODS) * abs(slope)
    for j in range(out.shape[0]):
        turns = np.float32(np.int32(phase[1][j]) - np.int32(phase[0][j]))
        step = np.float32(np.int32(pixel[1][j]) - np.int32(pixel[0][j]))
        width = max(abs(step), least)
        x = radians * turns * turns * (np.float32(PIXEL_STEPS**2) / (width * width) - left)
        x = min(max(x, _FEWEST), _MOST)
        lost = x / (one + x * (np.float32(0.5) + x * np.float32(1 / 12)))  # Pade approximation of 1 - exp(-x)
        usable = (known[0][j] & known[1][j]) != 0 and turns * slope > zero and abs(turns) <= most
        out[j] = lost * lost if usable else zero


@linked
def _widen_row(
    misfit: Any, normalised: Any, residual: Any, variance: Any, lost: Any, bias_share: Any, misfit_share: Any,
    more: Any, sigma: Any,
) -> None:  # fmt: skip
    one, half = np.float32(1.0), np.float32(0.5 * RESIDUAL_STEP**2)
    for j in range(misfit.shape[0]):
        e, b = np.float32(misfit[j]), np.float32(normalised[j]) - np.float32(residual[j])
        bias = bias_share + half * lost[j]
        sigma[j] *= np.float32(sqrt(one + (bias * b * b + misfit_share * e * e + more) / variance[j]))


@parallel_allocating
def widen_sigma(
    block: int, misfit: Any, match: Any, variance: Any, shares: Any, slopes: Any, stride: int, sigma: Any
) -> None:  # fmt: skip
    """Add the remaining errors to the standard deviation of the points in a block of :data:`ROWS` rows.

    Args:
        misfit: (h, w) uint8, see :class:`pipeline.filter.texture_agreement.Agreement`.
        match: :class:`pipeline.match.match_result.MatchResult`; its two residuals differ by the bias.
        variance: (h, w) float32, rad^2, of the left phase; the right one's is alike.
        shares: :class:`Shares`; slopes: expected phase steps per pixel of those (x, y), one of them 0.
        stride: pixel (a, b) of those is that at (stride a, stride b) of ``sigma`` (H, W) float32, which is changed;
            where there is no point it may become anything.
    """
    height, width = misfit.shape
    valid, phase = match.valid, match.absolute_phase
    lost = np.zeros(width, np.float32)
    slope = np.float32((slopes[0] + slopes[1]) * 2 * LAG * TURN_STEPS / (2 * np.pi))
    bias = np.float32(0.5 * shares.bias * RESIDUAL_STEP**2)
    mis, more = np.float32(0.5 * shares.misfit / MISFIT_STEPS**2), np.float32(0.5 * shares.variance)
    for i in range(block * ROWS, min((block + 1) * ROWS, height)):
        if abs(slopes[0]) >= abs(slopes[1]):
            u, n = match.right_u[i], width - 2 * LAG
            _lost_row(
                (valid[i, :n], valid[i, 2 * LAG :]), (phase[i, :n], phase[i, 2 * LAG :]), (u[:n], u[2 * LAG :]),
                slope, stride, lost[LAG : LAG + n],
            )  # fmt: skip
        elif LAG <= i < height - LAG:
            v, a, b = match.right_v, i - LAG, i + LAG
            _lost_row((valid[a], valid[b]), (phase[a], phase[b]), (v[a], v[b]), slope, stride, lost)
        else:
            lost[:] = np.float32(0.0)
        normalised, residual = match.residual_normalised[i], match.residual[i]
        if stride == 1:
            _widen_row(misfit[i], normalised, residual, variance[i], lost, bias, mis, more, sigma[i])
        else:
            _widen_row(misfit[i], normalised, residual, variance[i], lost, bias, mis, more, sigma[stride * i, ::stride])
