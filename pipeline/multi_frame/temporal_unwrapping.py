"""Temporal unwrapping: the period of the finest fringe, among those inside the measuring volume.

Other fringes, or the bits of a Gray code, are predicted for each of these periods. The best fit is accepted if it
is good and the next best does not (the method of excess fractions, Benoit 1898).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import whole_turns
from pipeline.decode.packed_phasor import PHASOR_SCALE, pack
from pipeline.multi_frame.n_step_kernel import BIT_STEPS

NONE = np.int16(-32768)
UNIT = np.float32(100.0)
"""Size of all phasors, counts, so that interpolation weights bright and dark pixels alike."""
_ZERO, _ONE, _TURN = np.float32(0), np.float32(1), np.float32(2 * np.pi)
_FAR, _CLEAR = np.float32(1e9), np.float32(4.0)
_EDGE, _UNCERTAIN = np.float32(0.25), np.float32(4)
_CERTAIN = np.float32(0.2) * BIT_STEPS


@inline
def _wrapped(a: Any) -> Any:
    return a - _TURN * whole_turns(a)


@parallel
def by_phase(
    i: int, phase: Any, amplitude: Any, variance: Any, low: Any, high: Any, ratio: Any, share: Any, min_amplitude:
    float, max_deviation: float, misfit: Any, order: Any, phasor: Any,
) -> None:  # fmt: skip
    """Orders from several fringes, and the phase of the first averaged with those of the others.

    Args:
        phase, amplitude, variance: (J, H, W), finest fringe first; the first planes of phase and variance become those
            of the average.
        low, high: (H, W) limits of the absolute phase in the measuring volume, radians.
        ratio: (J,) periods per period of the first; share: (J,) weights of the fringes in the phase, their sum is 1.
        min_amplitude: amplitude below which a pixel is unknown, counts; max_deviation: largest mean deviation of the
            fringes from each other, radians.
        misfit: (H, W), to which the mean square of that deviation, less its noise, is added.
        order: (H, W) int16, written, NONE where unknown; phasor: (H, W) int32, packed, 0 where unknown.
    """
    fringes, width = phase.shape[0], phase.shape[2]
    others = np.float32(fringes - 1)
    most = others * np.float32(max_deviation) * np.float32(max_deviation)
    for j in range(width):
        order[i, j], phasor[i, j] = NONE, 0
        usable = True
        for q in range(fringes):
            usable &= amplitude[q, i, j] >= min_amplitude
        if not usable or not high[i, j] > low[i, j]:
            continue
        main = phase[0, i, j]
        k0 = np.int32(np.ceil((low[i, j] - main) / _TURN))
        k1 = np.int32(np.floor((high[i, j] - main) / _TURN))
        best, second, chosen = _FAR, _FAR, int(k0)
        for k in range(k0, k1 + 1):
            cost = _ZERO
            for q in range(1, fringes):
                deviation = _wrapped(phase[q, i, j] - ratio[q] * (main + _TURN * np.float32(k)))
                cost += deviation * deviation
            if cost < best:
                second, best, chosen = best, cost, k
            elif cost < second:
                second = cost
        if best > most:
            misfit[i, j] += best / others
            continue
        if best * _CLEAR >= second:
            continue
        shift, noise, expected = _ZERO, share[0] * share[0] * variance[0, i, j], _ZERO
        for q in range(1, fringes):
            deviation = _wrapped(phase[q, i, j] - ratio[q] * (main + _TURN * np.float32(chosen)))
            shift += share[q] * deviation / ratio[q]
            noise += (share[q] / ratio[q]) ** 2 * variance[q, i, j]
            expected += variance[q, i, j] + ratio[q] * ratio[q] * variance[0, i, j]
        misfit[i, j] += (best - expected) / others
        main += shift
        phase[0, i, j], variance[0, i, j], order[i, j] = main, noise, np.int16(chosen)
        phasor[i, j] = pack(UNIT * np.cos(main), UNIT * np.sin(main), PHASOR_SCALE)


@inline
def _changing(edge: Any) -> Any:
    """The bit of a Gray code that changes at the edge between cells ``edge - 1`` and ``edge``, as a mask."""
    return (edge ^ (edge >> 1)) ^ ((edge - 1) ^ ((edge - 1) >> 1))


@inline
def _least_contrast_at(bits: Any, number: Any, i: int, j: int, place: Any) -> Any:
    """Evidence of the bits for a position in the code: the least contrast of the expected sign.

    The bit with an edge nearby is ignored.
    """
    cell, edge = np.int32(np.floor(place)), np.int32(np.rint(place))
    near = abs(place - np.float32(edge)) < _EDGE
    unclear = _changing(edge) if near else np.int32(0)
    code = cell ^ (cell >> 1)
    least = _FAR
    for b in range(bits.shape[0]):
        mask = np.int32(1) << number[b]
        if unclear & mask:
            continue
        value = np.float32(bits[b, i, j])
        value = value if code & mask else -value
        least = value if value < least else least
    return least


@inline
def _unevenness(bits: Any, number: Any, i: int, j: int, place: Any) -> Any:
    """Mean square deviation of the contrasts of the bits without an edge nearby, in amplitudes^2.

    It is computed for bright and dark bits apart, since the projector's response may make them unequal.
    """
    cell = np.int32(np.floor(place))
    unclear = _changing(cell) | _changing(cell + np.int32(1))
    n, total, square, m, other = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for b in range(bits.shape[0]):
        if unclear & (np.int32(1) << number[b]) == 0:
            value = np.float32(bits[b, i, j]) / BIT_STEPS
            square += value * value
            if value > _ZERO:
                n += _ONE
                total += value
            else:
                m += _ONE
                other += value
    square -= (total * total / n if n > _ZERO else _ZERO) + (other * other / m if m > _ZERO else _ZERO)
    free = n + m - (_ONE if n > _ZERO else _ZERO) - (_ONE if m > _ZERO else _ZERO)
    return square / free if free > _ZERO else _ZERO


@parallel
def by_bits(
    i: int, phase: Any, amplitude: Any, variance: Any, low: Any, high: Any, bits: Any, number: Any, per_period: float,
    steps: int, min_amplitude: float, misfit: Any, order: Any, phasor: Any,
) -> None:  # fmt: skip
    """Orders of one fringe from the bits of a Gray code.

    Args:
        phase, amplitude, variance: (1, H, W); low, high, min_amplitude, order, phasor: see :func:`by_phase`.
        bits: (n, H, W) int8, see :func:`pipeline.multi_frame.n_step_kernel.phases`; number: (n,) int32, position of
            each in the code, 0 = the least significant; per_period: cells of the code per period; steps: images of the
            fringe.
        misfit: (H, W), to which the mean square deviation of the bits' contrasts, less its noise, is added.
    """
    for j in range(order.shape[1]):
        order[i, j], phasor[i, j] = NONE, 0
        if not amplitude[0, i, j] >= min_amplitude or not high[i, j] > low[i, j]:
            continue
        main = phase[0, i, j]
        k0 = np.int32(np.ceil((low[i, j] - main) / _TURN))
        k1 = np.int32(np.floor((high[i, j] - main) / _TURN))
        best, second, chosen = -_FAR, -_FAR, int(k0)
        for k in range(k0, k1 + 1):
            contrast = _least_contrast_at(bits, number, i, j, (main / _TURN + np.float32(k)) * np.float32(per_period))
            if contrast > best:
                second, best, chosen = best, contrast, k
            elif contrast > second:
                second = contrast
        if best < _CERTAIN or second > -_CERTAIN:
            continue
        place = (main / _TURN + np.float32(chosen)) * np.float32(per_period)
        noise = np.float32(0.5) * np.float32(steps) * variance[0, i, j]
        misfit[i, j] += _unevenness(bits, number, i, j, place) - noise
        order[i, j] = np.int16(chosen)
        phasor[i, j] = pack(UNIT * np.cos(main), UNIT * np.sin(main), PHASOR_SCALE)


def reject_moved(
    order: Any, phasor: Any, amplitude: Any, misfit: Any, variance: Any, min_amplitude: Any, limit: Any,
    absolute_phase: Any,
) -> int:  # fmt: skip
    """Reject pixels whose images, and those of their neighbours, contradict each other, and count them.

    Contradictions of half of the lit pixels of a 5 x 5 window are due to motion; a border between two surfaces causes
    fewer. A pixel with a contradiction three times as large is rejected in any case, but not counted.

    Args:
        order, phasor: (H, W), changed in place; amplitude, misfit: (H, W), radians^2.
        variance: (H, W), of the phases; added to the limit, since dim pixels have a noisy misfit.
        limit: largest misfit, radians.
        absolute_phase: (H, W) float32, wrapped phases; becomes absolute, NaN where ``order`` is rejected.

    Returns:
        Number of lit pixels with motion.
    """
    vote, moved = np.empty(order.shape, np.uint8), np.zeros(len(order), np.int64)
    largest = np.float32(limit) * np.float32(limit)
    _vote_row(len(order), amplitude, misfit, variance, min_amplitude, largest, vote)
    _reject_row(len(order), vote, order, phasor, misfit, variance, largest, absolute_phase, moved)
    return int(moved.sum())


@parallel
def _vote_row(
    i: int, amplitude: Any, misfit: Any, variance: Any, min_amplitude: float, largest: Any, vote: Any
) -> None:  # fmt: skip
    """2 where a lit pixel's images contradict each other, 1 where they do not, 0 where it is dark."""
    for j in range(vote.shape[1]):
        lit = amplitude[i, j] >= min_amplitude
        vote[i, j] = (2 if misfit[i, j] > largest + _UNCERTAIN * variance[i, j] else 1) if lit else 0


@parallel
def _reject_row(
    i: int, vote: Any, order: Any, phasor: Any, misfit: Any, variance: Any, largest: Any, absolute_phase: Any,
    moved: Any,
) -> None:  # fmt: skip
    height, width = order.shape
    for j in range(width):
        if vote[i, j]:
            lit, against = 0, 0
            for y in range(max(0, i - 2), min(height, i + 3)):
                for x in range(max(0, j - 2), min(width, j + 3)):
                    lit += vote[y, x] != 0
                    against += vote[y, x] == 2
            if 2 * against >= lit:
                moved[i] += 1
                order[i, j] = NONE
            elif misfit[i, j] > np.float32(9) * (largest + _UNCERTAIN * variance[i, j]):
                order[i, j] = NONE
        if order[i, j] == NONE:
            phasor[i, j], absolute_phase[i, j] = 0, np.float32(np.nan)
        else:
            absolute_phase[i, j] += _TURN * np.float32(order[i, j])


@parallel
def confirm(
    i: int, valid: Any, absolute_phase: Any, right_u: Any, right_v: Any, other: Any, per_turn: float, limit: float
) -> None:
    """Reject matches whose pixel in the other image has another absolute phase, or none.

    Args:
        valid: (h, w) uint8, changed; absolute_phase, right_u, right_v: of
            :class:`pipeline.match.match_result.MatchResult`.
        other: (H, W) float32, absolute phases of the other image; limit: radians.
    """
    for j in range(valid.shape[1]):
        if valid[i, j] == 0:
            continue
        y, x = np.int32(right_v[i, j]) >> 3, np.int32(right_u[i, j]) >> 3
        deviation = np.int32(32768)
        if y < other.shape[0] and x < other.shape[1] and other[y, x] == other[y, x]:
            deviation = np.int32(np.rint(other[y, x] * np.float32(per_turn))) - np.int32(absolute_phase[i, j])
            deviation &= np.int32(65535)
            deviation = min(deviation, np.int32(65536) - deviation)
        if not np.float32(deviation) < np.float32(limit) * np.float32(per_turn):
            valid[i, j] = np.uint8(0)
