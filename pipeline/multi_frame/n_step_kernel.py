"""Phases of a set of shifted fringes, pixel by pixel, from the raw images of one camera.

The fringes are grey, so crosstalk only moves light between channels: the channels of a three-chip image are summed,
the pixels of a mosaic evaluated one by one. A channel that is saturated in one of the images is excluded from all of
them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import allocating_linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import angle, clamped, root

BIT_STEPS = np.float32(64.0)
"""Steps of a bit's contrast: 64 is the fringe's own amplitude."""
_ZERO, _ONE, _TINY = np.float32(0), np.float32(1), np.float32(1e-12)
_MOST = np.float32(127)


@allocating_linked
def load_row(
    stack: Any, i: int, channels: int, scale: float, black: Any, share: Any, saturation: float, row: Any
) -> int:
    """Samples of a row of all images, (F, W), in counts of light above black; 0 where everything is saturated.

    Args:
        stack: (F, H, W * channels) raw, counts once multiplied by ``scale``.
        black, share: (2, 2, channels), by parity of row and column: black level, and response to white light.
        row: (F + 2, W) float32, written; the last two rows get the factors of a sample's noise for floor and gain.

    Returns:
        Number of pixels with a saturated sample.
    """
    frames, width = stack.shape[0], row.shape[1]
    weight, power = row[frames], row[frames + 1]
    for j in range(width):
        weight[j], power[j] = _ZERO, _ZERO
    for f in range(frames):
        for j in range(width):
            row[f, j] = _ZERO
    saturated = np.zeros(width, np.uint8)
    top = np.empty(width, np.float32)
    for c in range(channels):
        for j in range(width):
            top[j] = _ZERO
        for f in range(frames):
            line = stack[f, i]
            for j in range(width):
                value = np.float32(line[channels * j + c])
                top[j] = value if value > top[j] else top[j]
        for j in range(width):
            fine = top[j] * scale < saturation
            top[j] = _ONE if fine else _ZERO
            saturated[j] |= np.uint8(0) if fine else np.uint8(1)
            weight[j] += top[j] * share[i & 1, j & 1, c]
            power[j] += top[j]
        for f in range(frames):
            line = stack[f, i]
            for j in range(width):
                row[f, j] += top[j] * (np.float32(line[channels * j + c]) * scale - black[i & 1, j & 1, c])
    for j in range(width):
        w = weight[j]
        weight[j] = _ONE / w if w > _ZERO else _ZERO
        power[j] *= weight[j] * weight[j]
    for f in range(frames):
        for j in range(width):
            row[f, j] *= weight[j]
    found = 0
    for j in range(width):
        found += saturated[j]
    return found


@parallel_allocating
def phases(
    i: int, stack: Any, channels: int, scale: float, black: Any, share: Any, saturation: float, floor: float, gain:
    float, index: Any, first: Any, solve: Any, rest: Any, rest_first: Any, harmonic: Any, bit_index: Any, bit_sign: Any,
    phase: Any, amplitude: Any, variance: Any, mean: Any, misfit: Any, bits: Any, saturated: Any,
) -> None:  # fmt: skip
    """Phase, amplitude and fit of every fringe of a set.

    Args:
        stack ... saturation: see :func:`load_row`; floor, gain: noise of a raw sample, counts^2 and counts^2 per count.
        index: (n,) images of all fringes, fringe after fringe; first: (J + 1,) start of each fringe in it.
        solve: (3, n), samples -> A, C, S; rest: (n, most) rows of the residual, fringe ``q`` has
            ``rest_first[q + 1] - rest_first[q]`` of them, each with as many numbers as the fringe has images.
        harmonic: (J, 2), second harmonic of the images in the first of those rows.
        bit_index, bit_sign: (n,) images of a Gray code, and -1 where one is inverted.
        phase, amplitude, variance: (J, H, W) float32, written: radians, counts, radians^2.
        mean: (H, W) float32, counts, written.
        misfit: (H, W) float32, written: mean square, in radians^2 of a phase, of the residuals and of the differences
            between the fringes' means, less their noise.
        bits: (n, H, W) int8, written: each bit's contrast to the mean, in :data:`BIT_STEPS` per amplitude.
        saturated: (H,) int32, pixels with a saturated sample.
    """
    width = mean.shape[1]
    frames, fringes = stack.shape[0], first.shape[0] - 1
    row = np.empty((frames + 2, width), np.float32)
    work = np.empty((6, width), np.float32)
    saturated[i] = load_row(stack, i, channels, scale, black, share, saturation, row)
    total, square, residual = work[3], work[4], work[5]
    for j in range(width):
        total[j], square[j], residual[j] = _ZERO, _ZERO, _ZERO
    n_residuals = 0
    for q in range(fringes):
        a, re, im = work[0], work[1], work[2]
        for j in range(width):
            a[j], re[j], im[j] = _ZERO, _ZERO, _ZERO
        spread = _ZERO
        for m in range(first[q], first[q + 1]):
            s0, s1, s2 = solve[0, m], solve[1, m], solve[2, m]
            spread += np.float32(0.5) * (s1 * s1 + s2 * s2)
            line = row[index[m]]
            for j in range(width):
                a[j] += s0 * line[j]
                re[j] += s1 * line[j]
                im[j] += s2 * line[j]
        for j in range(width):
            phase[q, i, j] = angle(re[j], im[j])
        for j in range(width):
            size = re[j] * re[j] + im[j] * im[j] + _TINY
            light = a[j] if a[j] > _ZERO else _ZERO
            # Of a sample: (floor + gain * counts) of each channel, over the sum of their responses.
            noise = floor * row[frames + 1, j] + gain * light * row[frames, j]
            amplitude[q, i, j] = root(size)
            variance[q, i, j] = spread * noise / size
            total[j] += a[j]
            square[j] += a[j] * a[j]
        for m in range(rest_first[q], rest_first[q + 1]):
            for j in range(width):
                light = a[j] if a[j] > _ZERO else _ZERO
                noise = floor * row[frames + 1, j] + gain * light * row[frames, j]
                size = re[j] * re[j] + im[j] * im[j] + _TINY
                over = _ZERO
                for k in range(first[q + 1] - first[q]):
                    over += rest[m, k] * row[index[first[q] + k], j]
                over -= (
                    harmonic[q, 0] * (re[j] * re[j] - im[j] * im[j]) - harmonic[q, 1] * np.float32(2) * re[j] * im[j]
                ) / root(size)
                residual[j] += (over * over - noise) / size
            n_residuals += 1
    n = np.float32(fringes)
    for j in range(width):
        middle = total[j] / n
        mean[i, j] = middle if middle > _ZERO else _ZERO
        difference = square[j] - n * middle * middle
        size = amplitude[0, i, j] * amplitude[0, i, j] + _TINY
        # The means' own noise: that of a phase times the amplitude, less a half.
        misfit[i, j] = (residual[j] + difference / size - (n - _ONE) * np.float32(0.5) * variance[0, i, j]) / (
            np.float32(n_residuals) + n - _ONE + _TINY
        )
    for b in range(bit_index.shape[0]):
        line, sign = row[bit_index[b]], bit_sign[b] * BIT_STEPS
        for j in range(width):
            value = sign * (line[j] - mean[i, j]) / (amplitude[0, i, j] + _TINY)
            bits[b, i, j] = np.int8(np.int32(np.rint(clamped(value, -_MOST, _MOST))))
