"""Decoding of a three-chip image in one pass over bands of rows.

Every row passes all steps while it is in the first caches; between the raw image and the results no plane is stored.
The bands overlap, so that each is independent: results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.decode.kernels.chromatic_correction import correct_means, correct_phasors, units_of_row
from pipeline.decode.kernels.color_gains import BLOCK, balanced_row, gains_of_row, widen_at_changes
from pipeline.decode.kernels.local_mean import advance, means_of_row, mirrored, shared_row
from pipeline.decode.kernels.local_normalisation import balance_of_row, brightness_of_row, normalised_row
from pipeline.decode.kernels.row_output import angles_of_row, counts_of_row, describe_row, row_stride
from pipeline.decode.kernels.saturated_fit import SATURATED_SLOTS, fit_saturated, plain_mean, saturated_of_row
from pipeline.decode.kernels.three_step import levels_of_row, pointwise_row
from pipeline.decode.kernels.window_fit import fold, fold_far
from pipeline.decode.packed_phasor import PHASOR_SCALE
from pipeline.decode.pixel_descriptor import complete_row, normalised_phase_row

BANDS = 12


@linked
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


@linked
def _sums_along(
    rows: Any, ur: Any, ui: Any, radius: int, nominal: Any, weights: Any, sums: Any, k: int, width: int
) -> None:
    """Sums of the window along a row into every ring's slot k of ``sums``; rows: (5 or more, ...) w, c, s, a, v.

    At the image's end the step of the phase is known from one side only: rotated back by it, the neighbour on that side
    equals the pixel and adds nothing. Its sum is the pixel alone, with the variance of one.
    """
    ring, o, n = sums.shape[0] // 5, max(radius, 1), width
    w, c, s, a, v = rows[0], rows[1], rows[2], rows[3], rows[4]
    fold(ur[o - 1 : o - 1 + n], ui[o - 1 : o - 1 + n], ur[o : o + n], ui[o : o + n],
         ur[o + 1 : o + 1 + n], ui[o + 1 : o + 1 + n],
         w[o - 1 : o - 1 + n], c[o - 1 : o - 1 + n], s[o - 1 : o - 1 + n], a[o - 1 : o - 1 + n],
         v[o - 1 : o - 1 + n], w[o : o + n], c[o : o + n], s[o : o + n], a[o : o + n], v[o : o + n],
         w[o + 1 : o + 1 + n], c[o + 1 : o + 1 + n], s[o + 1 : o + 1 + n], a[o + 1 : o + 1 + n],
         v[o + 1 : o + 1 + n], nominal[0], nominal[1], weights[1],
         sums[k, :n], sums[ring + k, :n], sums[2 * ring + k, :n], sums[3 * ring + k, :n],
         sums[4 * ring + k, :n])  # fmt: skip
    if radius == 2:
        fold_far(ur[1 : 1 + n], ui[1 : 1 + n], ur[2 : 2 + n], ui[2 : 2 + n], ur[3 : 3 + n], ui[3 : 3 + n],
                 ur[0:n], ui[0:n], ur[4 : 4 + n], ui[4 : 4 + n],
                 w[0:n], c[0:n], s[0:n], a[0:n], v[0:n],
                 w[4 : 4 + n], c[4 : 4 + n], s[4 : 4 + n], a[4 : 4 + n], v[4 : 4 + n],
                 nominal[0], nominal[1], weights[2],
                 sums[k, :n], sums[ring + k, :n], sums[2 * ring + k, :n], sums[3 * ring + k, :n],
                 sums[4 * ring + k, :n])  # fmt: skip
    for m in range(5):
        sums[m * ring + k, 0], sums[m * ring + k, n - 1] = rows[m, o], rows[m, o + n - 1]


@linked
def _sums_across(
    unit: Any, sums: Any, i: int, ends: bool, radius: int, nominal: Any, weights: Any, w: Any, c: Any, s: Any, a: Any,
    v: Any,
) -> None:  # fmt: skip
    """Sums of the window of row i, (W,), from the sums along the rows that the rings hold.

    Of the image's first and last row that along the row, see :func:`_sums_along`.
    """
    ring, n = unit.shape[0] // 2, w.shape[0]
    if ends:
        q = i % ring
        for j in range(n):
            w[j], c[j], s[j], a[j], v[j] = (sums[q, j], sums[ring + q, j], sums[2 * ring + q, j],
                                            sums[3 * ring + q, j], sums[4 * ring + q, j])  # fmt: skip
        return
    p, q, r = (i - 1) % ring, i % ring, (i + 1) % ring
    o, e = max(radius, 1), max(radius, 1) + n
    fold(unit[p, o:e], unit[ring + p, o:e], unit[q, o:e], unit[ring + q, o:e], unit[r, o:e], unit[ring + r, o:e],
         sums[p], sums[ring + p], sums[2 * ring + p], sums[3 * ring + p], sums[4 * ring + p],
         sums[q], sums[ring + q], sums[2 * ring + q], sums[3 * ring + q], sums[4 * ring + q],
         sums[r], sums[ring + r], sums[2 * ring + r], sums[3 * ring + r], sums[4 * ring + r],
         nominal[2], nominal[3], weights[1], w, c, s, a, v)  # fmt: skip
    if radius == 2:
        f, g = (i - 2) % ring, (i + 2) % ring
        fold_far(unit[p, o:e], unit[ring + p, o:e], unit[q, o:e], unit[ring + q, o:e], unit[r, o:e],
                 unit[ring + r, o:e], unit[f, o:e], unit[ring + f, o:e], unit[g, o:e], unit[ring + g, o:e],
                 sums[f], sums[ring + f], sums[2 * ring + f], sums[3 * ring + f], sums[4 * ring + f],
                 sums[g], sums[ring + g], sums[2 * ring + g], sums[3 * ring + g], sums[4 * ring + g],
                 nominal[2], nominal[3], weights[2], w, c, s, a, v)  # fmt: skip


@parallel_allocating
def decode_rgb(
    band: int, image: Any, black: Any, solve: Any, mix: Any, light: Any, unmix: Any, ideal: Any, weights: Any,
    radius: int, nominal: Any, saturation: float, floor: float, gain: float, min_modulation: float, along: int,
    over: int, drops: Any, scale: float, colored_from: Any, chromatic: Any, table_step: int, phasor: Any,
    descriptors: Any, mean: Any, brightness: Any, variance: Any, phase: Any, modulation: Any, valid: Any,
    saturated: Any,
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
        variance, phase: (H, W) float32; mean, brightness, modulation: (H, W) uint8;
        valid: (H, W) bool; saturated: (H,) int32, number of pixels with a saturated sample.
    """
    height, width = mean.shape
    reach = max(radius, 1)
    ring = 2 * reach + 1
    wide = row_stride(3 * width + 6 * along)
    low, high = band * height // BANDS, (band + 1) * height // BANDS
    # Beyond the ends of a row, and of the image, there is room for a window, whose weights are 0.
    slab = np.zeros((7 * ring + 18, row_stride(width + 2 * reach)), np.float32)
    first, end = reach, reach + width
    w, c, s = slab[0, first:end], slab[1, first:end], slab[2, first:end]
    a, v, re, im = slab[3, first:end], slab[4, first:end], slab[5, :width], slab[6, :width]
    average, levels, balance, gains = slab[7, :width], slab[8:11], slab[11:15], slab[15:18]
    unit, sums = slab[18 : 18 + 2 * ring], slab[18 + 2 * ring :]
    boxes = np.zeros((2 + over, wide), np.uint16)
    once, twice, before = boxes[0, : 3 * width], boxes[1, : 3 * width], boxes[2:]
    shorts = np.zeros((5, 2 * wide), np.uint16)
    padded, middle = shorts[0, : 3 * (width + 2 * along - 2)], shorts[1, : 3 * (width + along - 1)]
    work, means = shorts[2:4], shorts[4, : 3 * width]
    tile, columns = np.zeros(SATURATED_SLOTS * TILE, np.float32), np.empty(width + 1, np.int32)
    gains[:] = np.float32(1.0)
    blocks = (width + BLOCK - 1) // BLOCK
    flags, runs, n_runs = np.zeros(BLOCK * blocks + 16, np.uint8), np.zeros((blocks, 2), np.int32), np.int64(0)
    start = shared_row(max(low - reach, 0))
    middle_row, entered = start - 1, start - over
    for y in range(max(low - reach, 0), high + reach):
        k = y % ring
        if y < height:
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
                normalised_row(levels, balance, unmix, ideal, w, c, s)
                if table_step > 0:
                    correct_means(chromatic, table_step, y, w, c, s)
                    correct_phasors(chromatic, table_step, y, w, c)
                normalised_phase_row(w, c, descriptors[y])
                brightness_of_row(s, balance, brightness[y])
            ur, ui = unit[k, first:end], unit[ring + k, first:end]
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
            _sums_along(slab, unit[k], unit[ring + k], radius, nominal, weights, sums, k, width)
        else:
            unit[k::ring], sums[k::ring] = np.float32(0.0), np.float32(0.0)
        i = y - reach
        if low <= i:
            p, q, r = (i - 1) % ring, i % ring, (i + 1) % ring
            _sums_across(unit, sums, i, (i == 0) | (i == height - 1), radius, nominal, weights, w, c, s, a, v)
            quotients_of_row(w, c, s, a, v, re, im, average, variance[i])
            if saturated[i] > 0:
                count = saturated_of_row(image[i], saturation, columns)
                # The gains are those of the last row of the window, whose means differ little.
                for j in columns[:count]:
                    average[j] = plain_mean(image[i], j, black, solve)
                units = (unit[p], unit[ring + p], unit[q], unit[ring + q], unit[r], unit[ring + r])
                for j in range(0, count, TILE):
                    fit_saturated(image, i, columns[j : min(j + TILE, count)], radius, nominal, weights, mix,
                                  light, gains, black, saturation, floor, gain, units, tile, re, im, average,
                                  variance[i])  # fmt: skip
            counts_of_row(average, mean[i])
            angles_of_row(re, im, PHASOR_SCALE, phasor[i], phase[i])
            describe_row(re, im, variance[i], min_modulation, modulation[i], valid[i])
            complete_row(phase[i], valid[i], mean[i], descriptors[i])
