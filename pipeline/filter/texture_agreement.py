"""Agreement of both images' textures at matched pixels: mean and fringe amplitude of one surface point are alike.

A wrong match compares two different surface points. The relative differences of mean and amplitude are counted in
units of their own scatter in this pair, so gain, texture and noise of a rig need no limits of their own.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import linked, serial
from pipeline.common.median import median
from pipeline.common.parallel_for import blocks, parallel_allocating
from pipeline.match.match_result import PIXEL_STEPS, MatchResult

DEVIATION_STEPS = 16
"""Steps per standard deviation of :attr:`Agreement.deviation`."""
LOSS = np.log1p((np.arange(256) / DEVIATION_STEPS) ** 2 / 4)
"""Loss of a deviation, the logarithm of a Student distribution; by steps."""
NO_MATCH = np.uint8(255)
"""Deviation of a pixel without a match."""
MISFIT_STEPS = 256.0
"""Steps per radian of :attr:`Agreement.misfit`."""

ROWS = 8
"""Rows that share a scratch array: threads that allocate at the same time wait for each other."""
_SAMPLES, _APART = 7000, 9
_LEAST_SAMPLES = 200
_LEAST_MEAN, _LEAST_AMPLITUDE = 0.012, 0.012
MEAN_MISFIT, AMPLITUDE_MISFIT = 4.0, 2.0
"""Squared phase error per squared relative difference of the means, of the amplitudes, beyond :data:`HINGE`."""
AMPLITUDE_SHARE = 0.1
"""Weight of the amplitude in the deviation, the mean has the rest: on steep surfaces amplitudes differ, too."""
HINGE = 1.25
"""Squared deviations up to which a difference is taken as noise."""
_SHIFT = int(np.log2(PIXEL_STEPS))
_HALF, _ROUND, _LAST = PIXEL_STEPS // 2, PIXEL_STEPS - 1, 254
_OFFSET = np.float32(2.0)


class Scale(NamedTuple):
    """Centre and standard deviation of the relative differences of the means and of the amplitudes.

    Args:
        matched_loss: mean loss of matched pixels; unrelated_loss: of pixels some distance apart. Where there is no
            texture, both are alike.
    """

    mean: float
    mean_sigma: float
    amplitude: float
    amplitude_sigma: float
    matched_loss: float
    unrelated_loss: float


class Agreement(NamedTuple):
    """Planes (H, W) on the left camera's pixel grid.

    Args:
        deviation: uint8, rms deviation of mean and amplitude in :data:`DEVIATION_STEPS`; :data:`NO_MATCH` without one.
        misfit: uint8, phase error that the difference lets expect beyond noise, in :data:`MISFIT_STEPS`.
    """

    deviation: NDArray[np.uint8]
    misfit: NDArray[np.uint8]

    @staticmethod
    def empty(shape: tuple[int, int]) -> Agreement:
        """Planes to be written."""
        return Agreement(np.empty(shape, np.uint8), np.empty(shape, np.uint8))


@linked
def right_values_of_row(
    valid: Any, u: Any, v: Any, mean: Any, amplitude: Any, width: int, place: Any, values: Any, out: Any
) -> None:  # fmt: skip
    """Means and amplitudes of the right image, linear along the row, nearest row; ``out`` (2, W) float32.

    Look-ups, which do not vectorise, have a loop of their own; ``place`` (W,) int32 and ``values`` (4, W) uint8 are
    scratch.
    """
    last, n = np.int32(mean.shape[0] - 2), valid.shape[0]
    for j in range(n):
        x = np.int32(u[j]) - np.int32(_HALF)
        at = np.int32(np.int32(np.int32(v[j]) >> np.int32(_SHIFT)) * np.int32(width)) + (x >> np.int32(_SHIFT))
        place[j] = np.int32(at) if (valid[j] != 0) & (at >= 0) & (at <= last) else np.int32(0)
    a0, a1, b0, b1 = values[0], values[1], values[2], values[3]
    for j in range(n):
        k = np.uint32(place[j])
        a0[j], a1[j] = mean[k], mean[k + np.uint32(1)]
        b0[j], b1[j] = amplitude[k], amplitude[k + np.uint32(1)]
    means, amplitudes = out[0], out[1]
    for j in range(n):
        x = np.int32(u[j]) - np.int32(_HALF)
        f = (np.float32(x & np.int32(_ROUND)) + np.float32(0.5)) * np.float32(1 / PIXEL_STEPS)
        a, b = np.float32(a0[j]), np.float32(b0[j])
        means[j] = a + f * (np.float32(a1[j]) - a)
        amplitudes[j] = b + f * (np.float32(b1[j]) - b)


@linked
def deviations_of_row(valid: Any, mean: Any, amplitude: Any, right: Any, s: Any, deviation: Any, misfit: Any) -> None:
    """Deviation and misfit of a row from its values and ``right`` (2, W); s: of :func:`scales_of`."""
    zero, two, most = np.float32(0.0), np.float32(2.0), np.float32(_LAST)
    means, amplitudes = right[0], right[1]
    # Read before the loop: the compiler would gather them under the mask of the valid pixels.
    mean_centre, mean_weight, amplitude_centre, amplitude_weight = s[0], s[1], s[2], s[3]
    for j in range(valid.shape[0]):
        a, b = np.float32(mean[j]), np.float32(amplitude[j])
        mean_difference = two * (a - means[j]) / (a + means[j] + _OFFSET)
        difference = two * (b - amplitudes[j]) / (b + amplitudes[j] + _OFFSET)
        t, m = mean_difference - mean_centre, difference - amplitude_centre
        square = t * t * mean_weight + m * m * amplitude_weight
        z = np.float32(sqrt(square * np.float32(0.5))) * np.float32(DEVIATION_STEPS)
        t, m = mean_difference - s[8], difference - s[9]
        beyond = s[6] * max(t * t - s[4], zero) + s[7] * max(m * m - s[5], zero)
        e = np.float32(sqrt(beyond)) * np.float32(MISFIT_STEPS)
        deviation[j] = np.uint8(min(z, most)) if valid[j] != 0 else NO_MATCH
        misfit[j] = np.uint8(min(e, np.float32(255.0)))


@parallel_allocating
def _compare(
    block: int, valid: Any, u: Any, v: Any, mean: Any, amplitude: Any, right_mean: Any, right_amplitude: Any,
    width: int, scale: Any, deviation: Any, misfit: Any,
) -> None:  # fmt: skip
    """Fill :data:`ROWS` rows of the planes of :class:`Agreement`; right images flat, of this width."""
    n = valid.shape[1]
    right, place, values = np.empty((2, n), np.float32), np.empty(n, np.int32), np.empty((4, n), np.uint8)
    for i in range(block * ROWS, min((block + 1) * ROWS, valid.shape[0])):
        right_values_of_row(valid[i], u[i], v[i], right_mean, right_amplitude, width, place, values, right)
        deviations_of_row(valid[i], mean[i], amplitude[i], right, scale, deviation[i], misfit[i])


def compare(match: MatchResult, left: Any, right: Any, scale: Scale, inside: Scale, out: Agreement) -> None:
    """Compare mean and amplitude at every match; ``left``, ``right`` with planes ``mean`` and ``modulation``.

    Args:
        scale: of all matched pixels, for the deviation: a wall behind the volume shows how little true matches differ,
            where false ones would set their own scale; inside: of those in the volume, for the misfit.
    """
    _compare(
        blocks(len(match.valid), ROWS), match.valid, match.right_u, match.right_v, left.mean, left.modulation,
        right.mean.reshape(-1), right.modulation.reshape(-1), right.mean.shape[1], scales_of(scale, inside),
        out.deviation, out.misfit,
    )  # fmt: skip


def scales_of(scale: Scale, inside: Scale) -> NDArray[np.float32]:
    """Constants of :func:`deviations_of_row`, (10,)."""
    mean_weight, amplitude_weight = 2 * (1 - AMPLITUDE_SHARE), 2 * AMPLITUDE_SHARE
    return np.array(
        [
            scale.mean, mean_weight * scale.mean_sigma**-2.0,
            scale.amplitude, amplitude_weight * scale.amplitude_sigma**-2.0,
            HINGE * inside.mean_sigma**2, HINGE * inside.amplitude_sigma**2, MEAN_MISFIT, AMPLITUDE_MISFIT,
            inside.mean, inside.amplitude,
        ],
        np.float32,
    )  # fmt: skip


def scale_of(match: MatchResult, left: Any, right: Any) -> Scale:
    """Scale of the differences in this pair: medians over the matched pixels of a grid.

    Args:
        left, right: with planes ``mean`` and ``modulation``.
    """
    return _scale(_samples(match, left, right)[1])


def scale_and_inside(
    match: MatchResult, left: Any, right: Any, depth: Any, limits: tuple[np.float32, np.float32]
) -> tuple[Scale, Scale]:
    """:func:`scale_of`, and the scale of the pixels whose depth (H, W) lies within the limits, mm."""
    at, samples = _samples(match, left, right)
    scale, z = _scale(samples), depth[np.divmod(at, depth.shape[1])]
    inside = (z >= limits[0]) & (z <= limits[1])
    return scale, scale if inside.all() else _scale(samples[:, inside])


@serial
def _sample(
    valid: Any, u: Any, v: Any, mean: Any, amplitude: Any, right_mean: Any, right_amplitude: Any, step: int, at: Any,
    out: Any,
) -> int:  # fmt: skip
    """Pixels (n,) and values (4, n) of :func:`_samples`; their number."""
    height, width = right_mean.shape
    n = 0
    for i in range(0, valid.shape[0], step):
        for j in range(0, valid.shape[1], step):
            if valid[i, j] != 0:
                y = min(np.int64(v[i, j]) // PIXEL_STEPS, height - 1)
                x = min(np.int64(u[i, j]) // PIXEL_STEPS, width - 1)
                out[0, n], out[1, n] = mean[i, j], right_mean[y, x]
                out[2, n], out[3, n] = amplitude[i, j], right_amplitude[y, x]
                at[n] = i * valid.shape[1] + j
                n += 1
    return n


def _samples(match: MatchResult, left: Any, right: Any) -> tuple[Any, Any]:
    """Numbers (n,) of the matched pixels of a grid, and left and right mean, left and right amplitude there (4, n)."""
    step = max(1, round((match.valid.size / _SAMPLES) ** 0.5))
    height, width = (-(-n // step) for n in match.valid.shape)
    at, values = np.empty(height * width, np.int32), np.empty((4, height * width), np.float32)
    n = _sample(
        match.valid, match.right_u, match.right_v, left.mean, left.modulation, right.mean, right.modulation, step, at,
        values,
    )  # fmt: skip
    return at[:n], values[:, :n]


def _scale(samples: Any) -> Scale:
    """The scale of values (4, n), see :func:`_samples`."""
    count = samples.shape[1]
    if count < _LEAST_SAMPLES:
        return Scale(0.0, 0.02, 0.0, 0.04, 0.0, 0.0)
    values: list[float] = []
    squares = np.zeros((2, count), np.float32)
    limits = (_LEAST_MEAN, 1 - AMPLITUDE_SHARE), (_LEAST_AMPLITUDE, AMPLITUDE_SHARE)
    for (a, b), (least, share) in zip((samples[:2], samples[2:]), limits, strict=True):
        ratio = _relative_difference(a, b)
        centre = median(ratio)
        sigma = max(1.4826 * median(np.abs(ratio - centre)), least)
        values += [centre, sigma]
        squares[0] += share * ((ratio - centre) / sigma) ** 2
        squares[1] += share * ((_relative_difference(a, np.roll(b, _APART)) - centre) / sigma) ** 2
    steps = np.minimum(np.sqrt(squares) * DEVIATION_STEPS, _LAST).astype(np.uint8)
    return Scale(*values, *(float(row.mean()) for row in LOSS[steps]))


def _relative_difference(a: Any, b: Any) -> Any:
    return 2 * (a - b) / (a + b + _OFFSET)
