"""Decoding of a three-chip image in one pass over bands of rows.

Every row passes all steps while it is in the first caches; between the raw image and the results no plane is stored.
The bands overlap, so that each is independent: results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import TILE
from pipeline.decode.kernels.chromatic_correction import correct_means, correct_phasors, units_of_row
from pipeline.decode.kernels.color_gains import BLOCK, balanced_row, gains_of_row, widen_at_changes
from pipeline.decode.kernels.local_mean import advance, means_of_row, mirrored, shared_row
from pipeline.decode.kernels.local_normalisation import balance_of_row, normalised_row
from pipeline.decode.kernels.row_output import angles_of_row, counts_of_row, describe_row, row_stride
from pipeline.decode.kernels.saturated_fit import SATURATED_SLOTS, fit_saturated, plain_mean, saturated_of_row
from pipeline.decode.kernels.three_step import levels_of_row, pointwise_row
from pipeline.decode.kernels.window_fit import fold, fold_far
from pipeline.decode.packed_phasor import PHASOR_SCALE
from pipeline.decode.pixel_descriptor import complete_row, normalised_phase_row

BANDS = 12


@serial
def quotients_of_row(w: Any, c: Any, s: Any, a: Any, v: Any, re: Any, im: Any, mean: Any, variance: Any) -> None:
    """Means of weighted sums, and the variance of the angle, rad^2; 0, 0, 0 and inf where the weight is 0."""
    zero, one = np.float32(0.0), np.float32(1.0)
    inf = np.float32(np.inf)
    for j in range(mean.shape[0]):
        count = w[j] > zero
        inverse = one / (w[j] if count else one)
        re[j], im[j], mean[j] = c[j] * inverse, s[j] * inverse, a[j] * inverse
        angular = v[j] / (c[j] * c[j] + s[j] * s[j] + np.float32(1e-9))
        variance[j] = angular if count else inf


@parallel
def decode_rgb(
    band: int, image: Any, black: Any, solve: Any, mix: Any, light: Any, unmix: Any, ideal: Any, weights: Any,
    radius: int, nominal: Any, saturation: float, floor: float, gain: float, min_modulation: float, along: int,
    over: int, drops: Any, scale: float, colored_from: Any, chromatic: Any, table_step: int, phasor: Any,
    descriptors: Any, mean: Any, variance: Any, phase: Any, modulation: Any, valid: Any, saturated: Any,
) -> None:  # fmt: skip
    """Fill the planes of a :class:`pipeline.decode.decoder.PhaseMap`.

    Args:
        image: (H, 3 W) uint8; black: (3,) counts.
        solve: (3, 3) inverse of the channels' design; mix: (3, 3) crosstalk; light: (3, 3) design of the projector's
            channels; unmix: (3, 3) inverse crosstalk; ideal: (3, 3) inverse of the design without crosstalk; float32.
        weights: (3,) by distance; radius: of the window, pixels; nominal: (4,) expected steps of the phase.
        saturation: counts from which a sample is saturated; floor, gain: noise model; min_modulation: counts.
        along, over, drops, scale: of :class:`pipeline.decode.kernels.local_mean.BoxMean`.
        colored_from: (2,), of :func:`pipeline.decode.kernels.color_gains.limits_of`.
        chromatic, table_step: table and step of :class:`pipeline.decode.chromatic_phase.ChromaticCorrection`.
        phasor: (H, W) int32, packed; descriptors: (H, W) int32, see :mod:`pipeline.decode.pixel_descriptor`;
        variance, phase: (H, W) float32; mean, modulation: (H, W) uint8;
        valid: (H, W) bool; saturated: (H,) int32, number of pixels with a saturated sample.
    """
    height, width = mean.shape
    reach = max(radius, 1)
    ring, n = 2 * reach + 1, width - 2 * reach
    inf, zero = np.float32(np.inf), np.float32(0.0)
    wide = row_stride(3 * width + 6 * along)
    low, high = band * height // BANDS, (band + 1) * height // BANDS
    slab = np.zeros((7 * ring + 17, row_stride(width)), np.float32)
    levels, w, c, s = slab[0:3], slab[3, :width], slab[4, :width], slab[5, :width]
    a, v, re, im = slab[6, :width], slab[7, :width], slab[8, :width], slab[9, :width]
    average, balance = slab[10, :width], slab[11:14]
    gains, unit, sums = slab[14:17], slab[17 : 17 + 2 * ring], slab[17 + 2 * ring :]
    boxes = np.zeros((2 + over, wide), np.uint16)
    once, twice, before = boxes[0, : 3 * width], boxes[1, : 3 * width], boxes[2:]
    shorts = np.zeros((5, 2 * wide), np.uint16)
    padded, middle = shorts[0, : 3 * (width + 2 * along - 2)], shorts[1, : 3 * (width + along - 1)]
    work, means = shorts[2:4], shorts[4, : 3 * width]
    tile, columns = np.zeros(SATURATED_SLOTS * TILE, np.float32), np.empty(width + 1, np.int32)
    gains[:] = np.float32(1.0)
    blocks = (width + BLOCK - 1) // BLOCK
    flags, runs, n_runs = np.zeros(BLOCK * blocks + 16, np.uint8), np.zeros((blocks, 2), np.int32), 0
    start = shared_row(max(low - reach, 0))
    middle_row, entered = start - 1, start - over
    for y in range(max(low - reach, 0), min(high + reach, height)):
        levels_of_row(image[y], np.float32(1.0), black, levels)
        if middle_row < shared_row(y):
            middle_row = shared_row(y)
            while entered < middle_row + over - 1:
                entered += 1
                keep = 1 if entered > start else 0
                leaving = mirrored(entered - keep * over, height)
                advance(image[mirrored(entered, height)], image[leaving], keep, drops[0], drops[1], once,
                        before[(entered - start) % over], twice)  # fmt: skip
            means_of_row(twice, along, drops[2], drops[3], padded, middle, work, means)
            balance_of_row(means, scale, black, unmix, balance)
            n_runs = gains_of_row(balance, colored_from, width, flags, runs, n_runs, gains)
        if low <= y < high:
            normalised_row(levels, balance, unmix, ideal, w, c)
            if table_step > 0:
                correct_phasors(chromatic, table_step, y, w, c)
            normalised_phase_row(w, c, descriptors[y])
        k = y % ring
        ur, ui = unit[k, :width], unit[ring + k, :width]
        count = pointwise_row(levels, black, solve, saturation, floor, gain, ur, ui, w, c, s, a, v)
        for run in range(n_runs):
            e, f = runs[run, 0], runs[run, 1]
            balanced_row(levels, gains, e, unmix, ideal, floor, gain, ur[e:f], ui[e:f], w[e:f], c[e:f], s[e:f],
                         a[e:f], v[e:f])  # fmt: skip
            widen_at_changes(gains, e, f, c, s, v)
        if low <= y < high:
            saturated[y] = count
        if table_step > 0:
            correct_means(chromatic, table_step, y, c, s, a)
            correct_phasors(chromatic, table_step, y, c, s)
            correct_phasors(chromatic, table_step, y, ur, ui)
            units_of_row(ur, ui)
        o = reach
        fold(ur[o - 1 : o - 1 + n], ui[o - 1 : o - 1 + n], ur[o : o + n], ui[o : o + n],
             ur[o + 1 : o + 1 + n], ui[o + 1 : o + 1 + n],
             w[o - 1 : o - 1 + n], c[o - 1 : o - 1 + n], s[o - 1 : o - 1 + n], a[o - 1 : o - 1 + n],
             v[o - 1 : o - 1 + n], w[o : o + n], c[o : o + n], s[o : o + n], a[o : o + n], v[o : o + n],
             w[o + 1 : o + 1 + n], c[o + 1 : o + 1 + n], s[o + 1 : o + 1 + n], a[o + 1 : o + 1 + n],
             v[o + 1 : o + 1 + n], nominal[0], nominal[1], weights[1],
             sums[k, o : o + n], sums[ring + k, o : o + n], sums[2 * ring + k, o : o + n],
             sums[3 * ring + k, o : o + n], sums[4 * ring + k, o : o + n])  # fmt: skip
        if radius == 2:
            fold_far(ur[1 : 1 + n], ui[1 : 1 + n], ur[2 : 2 + n], ui[2 : 2 + n], ur[3 : 3 + n], ui[3 : 3 + n],
                     ur[0:n], ui[0:n], ur[4 : 4 + n], ui[4 : 4 + n],
                     w[0:n], c[0:n], s[0:n], a[0:n], v[0:n],
                     w[4 : 4 + n], c[4 : 4 + n], s[4 : 4 + n], a[4 : 4 + n], v[4 : 4 + n],
                     nominal[0], nominal[1], weights[2],
                     sums[k, o : o + n], sums[ring + k, o : o + n], sums[2 * ring + k, o : o + n],
                     sums[3 * ring + k, o : o + n], sums[4 * ring + k, o : o + n])  # fmt: skip
        i = y - reach
        if low <= i and i >= reach:
            p, q, r = (i - 1) % ring, i % ring, (i + 1) % ring
            fold(unit[p], unit[ring + p], unit[q], unit[ring + q], unit[r], unit[ring + r],
                 sums[p], sums[ring + p], sums[2 * ring + p], sums[3 * ring + p], sums[4 * ring + p],
                 sums[q], sums[ring + q], sums[2 * ring + q], sums[3 * ring + q], sums[4 * ring + q],
                 sums[r], sums[ring + r], sums[2 * ring + r], sums[3 * ring + r], sums[4 * ring + r],
                 nominal[2], nominal[3], weights[1], w, c, s, a, v)  # fmt: skip
            if radius == 2:
                f, g = (i - 2) % ring, (i + 2) % ring
                fold_far(unit[p], unit[ring + p], unit[q], unit[ring + q], unit[r], unit[ring + r],
                         unit[f], unit[ring + f], unit[g], unit[ring + g],
                         sums[f], sums[ring + f], sums[2 * ring + f], sums[3 * ring + f], sums[4 * ring + f],
                         sums[g], sums[ring + g], sums[2 * ring + g], sums[3 * ring + g], sums[4 * ring + g],
                         nominal[2], nominal[3], weights[2], w, c, s, a, v)  # fmt: skip
            quotients_of_row(w, c, s, a, v, re, im, average, variance[i])
            if saturated[i] > 0:
                count = saturated_of_row(image[i], saturation, reach, width - reach, columns)
                # The gains are those of the last row of the window, whose means differ little.
                for j in columns[:count]:
                    average[j] = plain_mean(image[i], j, black, solve)
                units = (unit[p], unit[ring + p], unit[q], unit[ring + q], unit[r], unit[ring + r])
                for j in range(0, count, TILE):
                    fit_saturated(image, i, columns[j : min(j + TILE, count)], radius, nominal, weights, mix,
                                  light, gains, black, saturation, floor, gain, units, tile, re, im, average,
                                  variance[i])  # fmt: skip
            for j in range(reach):
                for x in (j, width - 1 - j):
                    re[x], im[x], variance[i, x] = zero, zero, inf
                    average[x] = plain_mean(image[i], x, black, solve)
            counts_of_row(average, mean[i])
            angles_of_row(re, im, PHASOR_SCALE, phasor[i], phase[i])
            describe_row(re, im, variance[i], min_modulation, modulation[i], valid[i])
            complete_row(phase[i], valid[i], mean[i], descriptors[i])
        if low <= y < high and (y < reach or y >= height - reach):
            phasor[y, :], phase[y, :], variance[y, :], modulation[y, :], valid[y, :] = 0, zero, inf, 0, False
            for x in range(width):
                average[x] = plain_mean(image[y], x, black, solve)
            counts_of_row(average, mean[y])
            complete_row(phase[y], valid[y], mean[y], descriptors[y])
