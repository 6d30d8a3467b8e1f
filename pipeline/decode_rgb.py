"""Decoding of a three-chip picture in one pass over bands of rows.

Every row goes through all steps while it is in the processor's first caches; between the raw picture and the results
no plane is stored.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from pipeline.angles import angle
from pipeline.equalize import advance, equalized_row, means_of_row, mirrored
from pipeline.kernels import parallel, prange, serial
from pipeline.three_step import levels_of_row, pointwise_row
from pipeline.window_fit import fold

BANDS = 16


@serial
def angles_of_row(re: Any, im: Any, phasor: Any, phase: Any) -> None:
    """Phasors (n,) to an interleaved row (2 n,) and their angles (n,), all float32."""
    for j in range(phase.shape[0]):
        c, s = re[j], im[j]
        phasor[2 * j], phasor[2 * j + 1] = c, s
        phase[j] = angle(c, s)


@serial
def describe_row(re: Any, im: Any, variance: Any, smallest: float, modulation: Any, valid: Any) -> None:
    """Modulation (n,) uint8 counts and validity (n,) bool of a row."""
    full, one = np.float32(255.0), np.float32(1.0)
    for j in range(modulation.shape[0]):
        size = np.float32(sqrt(re[j] * re[j] + im[j] * im[j]))
        modulation[j] = np.uint8(np.int32(min(size, full)))
        valid[j] = (size >= smallest) & (variance[j] < one)


@serial
def quotients_of_row(w: Any, c: Any, s: Any, a: Any, v: Any, re: Any, im: Any, mean: Any, variance: Any) -> None:
    """Means of weighted sums, and the variance of the angle, rad^2; 0, 0, 0 and inf where the weight is 0."""
    zero, one = np.float32(0.0), np.float32(1.0)
    inf = np.float32(np.inf)
    for j in range(mean.shape[0]):
        found = w[j] > zero
        inverse = one / (w[j] if found else one)
        re[j], im[j], mean[j] = c[j] * inverse, s[j] * inverse, a[j] * inverse
        variance[j] = v[j] / (c[j] * c[j] + s[j] * s[j] + np.float32(1e-9)) if found else inf


@parallel
def decode_rgb(
    picture: Any, black: Any, solve: Any, unmix: Any, ideal: Any, weights: Any, nominal: Any, clip: float,
    floor: float, gain: float, smallest: float, along: int, over: int, first: int, second: int, scale: float,
    phasor: Any, equalized: Any, mean: Any, variance: Any, phase: Any, phase_eq: Any, modulation: Any, valid: Any,
    clipped: Any,
) -> None:  # fmt: skip
    """Fill the planes."""
    height, width = mean.shape
    radius = 1
    ring = 3
    zero = np.float32(0.0)
    for band in prange(BANDS):
        low, high = band * height // BANDS, (band + 1) * height // BANDS
        levels = np.empty((3, width), np.float32)
        unit_re, unit_im = np.empty((ring, width), np.float32), np.empty((ring, width), np.float32)
        w, c, s = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        a, v = np.empty(width, np.float32), np.empty(width, np.float32)
        # Sums along the rows, of the last rows.
        along_w, along_c = np.zeros((ring, width), np.float32), np.zeros((ring, width), np.float32)
        along_s, along_a = np.zeros((ring, width), np.float32), np.zeros((ring, width), np.float32)
        along_v = np.zeros((ring, width), np.float32)
        re, im = np.zeros(width, np.float32), np.zeros(width, np.float32)
        once, twice = np.zeros(3 * width, np.int32), np.zeros(3 * width, np.int32)
        before = np.zeros((over, 3 * width), np.int32)
        padded, middle = np.empty(3 * width + 6 * along - 6, np.uint16), np.empty(3 * width + 3 * along - 3, np.uint16)
        work, means = np.empty((2, 3 * width + 6 * along - 6), np.uint16), np.empty(3 * width, np.uint16)
        n = width - 2
        for y in range(low - over + 1, low + over - 1):
            advance(picture[mirrored(y, height)], picture[mirrored(y - over, height)], 1 if y > low else 0, once,
                    before[(y - low) % over], twice)  # fmt: skip
        for y in range(max(low - 1, 0), min(high + 1, height)):
            levels_of_row(picture[y], black, levels)
            if low <= y < high:
                advance(picture[mirrored(y + over - 1, height)], picture[mirrored(y - 1, height)], 1, once,
                        before[(y + over - 1 - low) % over], twice)  # fmt: skip
                means_of_row(twice, along, first, second, padded, middle, work, means)
                equalized_row(levels, means, scale, black, unmix, ideal, w, c)
                angles_of_row(w, c, equalized[y], phase_eq[y])
            ur, ui = unit_re[y % ring], unit_im[y % ring]
            pointwise_row(levels, black, solve, clip, floor, gain, ur, ui, w, c, s, a, v)
            fold(ur[0:n], ui[0:n], ur[1 : 1 + n], ui[1 : 1 + n], ur[2 : 2 + n], ui[2 : 2 + n],
                 w[0:n], c[0:n], s[0:n], a[0:n], v[0:n],
                 w[1 : 1 + n], c[1 : 1 + n], s[1 : 1 + n], a[1 : 1 + n], v[1 : 1 + n],
                 w[2 : 2 + n], c[2 : 2 + n], s[2 : 2 + n], a[2 : 2 + n], v[2 : 2 + n],
                 nominal[0], nominal[1], weights[0], weights[1],
                 along_w[y % ring, 1 : 1 + n], along_c[y % ring, 1 : 1 + n], along_s[y % ring, 1 : 1 + n],
                 along_a[y % ring, 1 : 1 + n], along_v[y % ring, 1 : 1 + n])  # fmt: skip
            i = y - 1
            if i <= low - 1 or i < 1:
                continue
            p, q, r = (i - 1) % ring, i % ring, (i + 1) % ring
            fold(unit_re[p], unit_im[p], unit_re[q], unit_im[q], unit_re[r], unit_im[r],
                 along_w[p], along_c[p], along_s[p], along_a[p], along_v[p],
                 along_w[q], along_c[q], along_s[q], along_a[q], along_v[q],
                 along_w[r], along_c[r], along_s[r], along_a[r], along_v[r],
                 nominal[2], nominal[3], weights[0], weights[1], w, c, s, a, v)  # fmt: skip
            quotients_of_row(w, c, s, a, v, re, im, mean[i], variance[i])
            angles_of_row(re, im, phasor[i], phase[i])
            describe_row(re, im, variance[i], smallest, modulation[i], valid[i])
