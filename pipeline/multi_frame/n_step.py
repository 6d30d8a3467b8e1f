"""Phase of shifted fringes in N steps, and temporal unwrapping.

Sample n of a pixel is ``I_n = A + B cos(Phi + s_n)`` with given shifts s_n: linear in ``A, C = B cos(Phi), S = B
sin(Phi)``, so least squares over any three or more shifts solve it (Bruning et al., Appl. Opt. 13, 2693, 1974). The
finest fringe gives the phase; a coarser one determines in which of its periods a pixel lies (Huntley and Saldner, Appl.
Opt. 32, 3047, 1993), level by level down to a fringe of at most one period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import PatternError
from pipeline.decode.noise_model import NoiseModel

F64: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]

_TURN = 2 * np.pi
_WORST_CONDITION = 50.0
_FEWEST_PIXELS = 200


@dataclass(frozen=True, slots=True, eq=False)
class WrappedPhase:
    """Phase of one set of shifted fringes, all (H, W).

    Args:
        phase: radians, -pi..pi; any value where the amplitude is 0.
        amplitude: B, counts of an 8-bit image; mean: A, likewise.
        saturated: a sample is saturated; phase and amplitude are then wrong.
        floor_factor, gain_factor: the variance of the phase is ``floor * floor_factor + gain * gain_factor`` for a
            noise of ``floor + gain * counts``.
        steps: number of images.
    """

    phase: F64
    amplitude: F64
    mean: F64
    saturated: Bools
    floor_factor: F64
    gain_factor: F64
    steps: int

    def sigma(self, noise: NoiseModel) -> F64:
        """Standard deviation of the phase from the images' noise, (H, W), radians."""
        return np.asarray(np.sqrt(noise.floor * self.floor_factor + noise.gain * np.maximum(self.gain_factor, 0)))


def wrapped_phase(planes: Sequence[F64], shifts: Sequence[float], saturated: Sequence[Bools] = ()) -> WrappedPhase:
    """Least-squares phase of images (H, W) of one fringe with these shifts, radians.

    Args:
        planes: counts of the images, one for each shift; any iterable, each is read once.
        saturated: where each image is saturated; empty = nowhere.

    Raises:
        PatternError: when these shifts do not determine the three unknowns.
    """
    s = np.asarray(shifts, dtype=np.float64)
    solve = solution_of(s)
    c, q = solve[1], solve[2]
    # Rows: A, C, S, and the sums for the variance of C, S from shot noise.
    rows = np.stack([*solve, c * c, c * q, q * q])
    total: F64 | None = None
    for row, plane in zip(rows.T, planes, strict=True):
        if total is None:
            total = np.zeros((len(rows), *plane.shape))
        for k, weight in enumerate(row):
            total[k] += weight * plane
    assert total is not None  # noqa: S101 (there are at least three)
    mean, re, im, gain_cc, gain_cs, gain_ss = total
    square = re * re + im * im
    with np.errstate(divide="ignore", invalid="ignore"):
        # d phase = (C dS - S dC) / B^2
        floor = (re * re * (q @ q) - 2 * re * im * (c @ q) + im * im * (c @ c)) / square**2
        gain_term = (re * re * gain_ss - 2 * re * im * gain_cs + im * im * gain_cc) / square**2
    none = np.zeros(mean.shape, np.bool_)
    any_saturated = np.logical_or.reduce([none, *saturated])
    return WrappedPhase(np.arctan2(im, re), np.sqrt(square), mean, any_saturated, floor, gain_term, len(s))


def unwrapped(
    coarse: F64, coarse_sigma: F64, phase: F64, sigma: F64, ratio: float, *, certainty: float = 3.0, edge: bool = False
) -> F64:
    """Absolute phase of a fringe from that of a coarser one, NaN where its period is not certain.

    A pixel is accepted when the coarser phase determines the finer period, also after a change by ``certainty``
    standard deviations of their difference.

    Args:
        coarse: absolute phase of the coarser fringe; phase: wrapped phase of the finer one; radians.
        coarse_sigma, sigma: their standard deviations.
        ratio: periods of the finer one per period of the coarser one.
        edge: the coarser fringe has just one period, and noise may have wrapped it from one end to the other.
    """
    best = np.full(phase.shape, np.nan)
    least = np.full(phase.shape, np.inf)
    for turn in (0.0, -1.0, 1.0) if edge else (0.0,):
        expected = ratio * (coarse + turn * _TURN)
        absolute = phase + _TURN * np.rint((expected - phase) / _TURN)
        deviation = np.abs(absolute - expected)
        if edge:
            deviation[(absolute < 0) | (absolute > ratio * _TURN)] = np.inf
        with np.errstate(invalid="ignore"):
            closer = deviation < least
        best[closer], least[closer] = absolute[closer], deviation[closer]
    with np.errstate(invalid="ignore"):
        certain = least + certainty * np.hypot(ratio * coarse_sigma, sigma) < np.pi
    best[~certain] = np.nan
    return best


def noise_of(sets: Sequence[WrappedPhase]) -> NoiseModel:
    """Noise of a sample, from two sets' means of the same scene, which differ by noise only.

    The two with the most steps are compared, in groups of equal brightness; robust against some moving pixels. With
    fewer than two sets, or too few pixels, half a count (rounding, a quiet sensor) is taken.
    """
    best = sorted(sets, key=lambda one: -one.steps)[:2]
    if len(best) < 2:
        return NoiseModel(0.25, 0.0)
    a, b = best
    fine = ~(a.saturated | b.saturated)
    level, difference = (a.mean[fine] + b.mean[fine]) / 2, a.mean[fine] - b.mean[fine]
    if len(level) < _FEWEST_PIXELS:
        return NoiseModel(0.25, 0.0)
    order = np.argsort(level, kind="stable")
    groups = np.array_split(order, min(16, len(order) // 100))
    x = np.array([level[g].mean() for g in groups])
    y = np.array([_variance(difference[g]) for g in groups]) / (1 / a.steps + 1 / b.steps)
    design = np.stack([np.ones_like(x), x], axis=1) / y[:, None]
    floor, gain = np.linalg.lstsq(design, np.ones_like(y), rcond=None)[0]
    if gain < 0 or floor < 0:
        floor, gain = (float(y.mean()), 0.0) if gain < 0 else (0.0, float((y / x).mean()))
    return NoiseModel(float(floor), float(gain))


def absolute_phase(
    sets: Sequence[WrappedPhase],
    periods: Sequence[float],
    noise: NoiseModel,
    *,
    min_amplitude: float = 5.0,
    certainty: float = 3.0,
) -> F64:
    """Absolute phase of the finest of several fringes, (H, W), radians; NaN where unknown.

    Args:
        sets: coarsest first; periods: of each over the projector, rising, the first at most 1.
        min_amplitude: of every set, counts.
        certainty: see :func:`unwrapped`.
    """
    if not sets or len(sets) != len(periods):
        raise PatternError(f"{len(sets)} sets of fringes with {len(periods)} numbers of periods: expected the same")
    if periods[0] > 1:
        raise PatternError(
            f"the coarsest fringe has {periods[0]:g} periods: an absolute phase needs one with at most 1; add it"
        )
    # The unused part of the first period lies half below the first column, half beyond the last one.
    lowest = -np.pi * (1 - periods[0])
    sigma = sets[0].sigma(noise)
    absolute = np.mod(sets[0].phase - lowest, _TURN) + lowest
    valid = (sets[0].amplitude >= min_amplitude) & ~sets[0].saturated
    for last, current, one in zip(periods, periods[1:], sets[1:], strict=False):
        finer = one.sigma(noise)
        edge = last == 1 and last == periods[0]
        absolute = unwrapped(absolute, sigma, one.phase, finer, current / last, certainty=certainty, edge=edge)
        valid &= (one.amplitude >= min_amplitude) & ~one.saturated
        sigma = finer
    if periods[0] == 1:
        # With one period the two ends of the image cannot be distinguished.
        near = certainty * sigma
        with np.errstate(invalid="ignore"):
            valid &= (absolute > near) & (absolute < _TURN * periods[-1] - near)
    return np.where(valid, absolute, np.nan)


def solution_of(shifts: F64) -> F64:
    """(3, n): samples -> A, C, S."""
    if len(shifts) < 3:
        raise PatternError(f"{len(shifts)} shifted fringes: expected at least 3")
    design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    if np.linalg.cond(design) > _WORST_CONDITION:
        raise PatternError(f"shifts {np.round(shifts, 3).tolist()!s:.80} do not separate phase, amplitude and mean")
    return np.asarray(np.linalg.pinv(design))


def _variance(values: F64) -> float:
    """Variance without the outliers; the values may be coarsely rounded, so that their median is unreliable."""
    low, high = np.quantile(values, [0.05, 0.95])
    middle, reach = (low + high) / 2, (high - low) * (4 / 3.29)
    return max(float(values[np.abs(values - middle) <= reach].var()), 1e-6)
