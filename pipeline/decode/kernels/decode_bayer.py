"""Decoding of a mosaic in one pass over bands of rows; three chips: :mod:`pipeline.decode.kernels.decode_rgb`."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import allocating_linked, linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.decode.kernels.chromatic_correction import (
    DESIGN_ROWS,
    correct_design,
    correct_means,
    correct_phasors,
    corrected_design,
    units_of_row,
)
from pipeline.decode.kernels.color_gains import BLOCK, balanced_units, design_of_row, gains_of_row
from pipeline.decode.kernels.decode_rgb import BANDS
from pipeline.decode.kernels.local_mean import advance, means_of_row, mirrored, shared_row
from pipeline.decode.kernels.local_normalisation import balance_of_row, brightness_of_row, normalised_row
from pipeline.decode.kernels.mosaic_fit import (
    AGREEING,
    EIGHTHS,
    MOSAIC_SLOTS,
    add_window_row,
    equal_contrast,
    padded_row,
    rough_row,
    rough_units,
    samples_of_row,
    start_tile,
)
from pipeline.decode.kernels.normal_equations import IM, MEAN, RE, VARIANCE, solve
from pipeline.decode.kernels.row_output import angles_of_row, copy_row, counts_of_row, describe_row, row_stride
from pipeline.decode.kernels.three_step import levels_of_row
from pipeline.decode.kernels.window_fit import continue_ends, continue_row
from pipeline.decode.packed_phasor import PHASOR_SCALE
from pipeline.decode.pixel_descriptor import complete_row, normalised_phase_row

REACH, RING = 2, 5
"""Pixels from the middle of the largest window to its ends, and its rows."""
COLORED = 1.7
"""Factor of the variance on strong colours, whose first guess is noisier: without it errors were 1.2 times sigma."""
AT_END, BESIDE_END = 2.0, 1.2
"""Factors of the variance of the image's outermost pixels and, in a row, of the next ones: their windows are cut, and
the error of the phase's step, taken from the first guess, does not cancel between both halves (measured)."""


@linked
def _design_rows(mosaic: Any, rows: Any, out: Any) -> None:
    """Design (a, p, q) of every column's colour in even and odd rows, out (6, ...)."""
    for k in range(6):
        for j in range(out.shape[1]):
            out[k, j] = rows[mosaic[k // 3, j & 1], k % 3]


@allocating_linked
def _first_guess(image: Any, y: int, mosaic: Any, padded: Any, cache: Any, cached_rows: Any) -> Any:
    """First guess of row y, (3 W,) uint16, from the cache or computed.

    Args:
        padded: (3, W + 2 or more) uint16, scratch; cache: (n, 3 W or more) uint16; cached_rows: (n,) their rows.
    """
    height, width = image.shape
    slot = y % cached_rows.shape[0]
    out = cache[slot, : 3 * width]
    if cached_rows[slot] != y:
        cached_rows[slot] = y
        for k in range(3):
            i = abs(y + k - 1)
            padded_row(image[i if i < height else 2 * height - 2 - i], padded[k, : width + 2])
        rough_row(padded[0], padded[1], padded[2], mosaic[y & 1, 0], mosaic[y & 1, 1], out)
    return out


@linked
def _write_tile(tile: Any, unit_re: Any, unit_im: Any, re: Any, im: Any, mean: Any, variance: Any) -> None:
    """Write the results of a tile; without a fit the mean is kept."""
    zero, most, inf = np.float32(0.0), np.float32(1024.0), np.float32(np.inf)
    for j in range(re.shape[0]):
        c, s = tile[RE * TILE + j], tile[IM * TILE + j]
        re[j], im[j] = c * unit_re[j] - s * unit_im[j], s * unit_re[j] + c * unit_im[j]
    for j in range(re.shape[0]):
        v = tile[VARIANCE * TILE + j]
        variance[j] = v
        mean[j] = min(max(tile[MEAN * TILE + j], zero), most) if v < inf else mean[j]


@linked
def _widen_colored(own: Any, plain: Any, variance: Any) -> None:
    """Raise the variance of a row (n,) where the design's first number is not that of a surface without gains."""
    one, factor, least = np.float32(1.0), np.float32(COLORED), np.float32(1e-4)
    for j in range(variance.shape[0]):
        variance[j] *= factor if abs(own[j] - plain[j]) > least else one


@linked
def _widen_ends(variance: Any, last: bool) -> None:
    """Raise the variance at both ends of a row (n,); ``last``: the row is the image's first or last."""
    most, more = np.float32(AT_END), np.float32(BESIDE_END)
    if last:
        for j in range(variance.shape[0]):
            variance[j] *= most
    for j, factor in ((0, most), (1, more)):
        variance[j] *= factor
        variance[variance.shape[0] - 1 - j] *= factor


@linked
def _continue_row(units: Any, row: int, inwards: int) -> None:
    """Unit phasors of a row at the image's end, or beyond, from the two rows next to it."""
    a, b, c = (row + inwards) % RING, (row + 2 * inwards) % RING, row % RING
    continue_row(units[a], units[RING + a], units[b], units[RING + b], units[c], units[RING + c])


@parallel_allocating
def decode_bayer(
    band: int, image: Any, mosaic: Any, rows: Any, black: Any, solution: Any, mix: Any, light: Any, unmix: Any,
    ideal: Any, weights: Any, radius: int, nominal: Any, saturation: float, floor: float, gain: float,
    min_modulation: float, along: int, over: int, drops: Any, scale: float, colored_from: Any, chromatic: Any,
    table_step: int, phasor: Any, descriptors: Any, mean: Any, brightness: Any, variance: Any, phase: Any,
    modulation: Any, valid: Any, saturated: Any,
) -> None:  # fmt: skip
    """Fill the planes of a :class:`pipeline.decode.decoder.PhaseMap`; image (H, W) uint8, mosaic (2, 2) channels.

    ``rows`` (3, 3) is the design of the channels; all else as in :func:`pipeline.decode.kernels.decode_rgb.decode_rgb`.
    """
    height, width = mean.shape
    # Every row has room for the largest window, whose weights beyond the image's end are 0, and for tiles that extend
    # beyond its end.
    stride = row_stride(width + TILE + 2 * REACH)
    wide = row_stride(3 * width + 6 * along)
    low, high = band * height // BANDS, (band + 1) * height // BANDS
    slab = np.zeros((8 * RING + 22, stride), np.float32)
    levels, design, equal = slab[0:3], slab[3:9], slab[8 * RING + 19 :]
    re, im, w = slab[9, :width], slab[10, :width], slab[11, :width]
    balance, units, samples = slab[12:16], slab[16 : 16 + 2 * RING], slab[16 + 2 * RING : 16 + 4 * RING]
    plain, gains = slab[16 + 4 * RING : 16 + 5 * RING], slab[16 + 5 * RING : 19 + 5 * RING]
    designs, own_design = slab[19 + 5 * RING : 19 + 8 * RING], np.zeros(RING, np.bool_)  # of rows with strong colours
    boxes = np.zeros((2 + over, wide), np.uint16)
    once, twice, before = boxes[0, : 3 * width], boxes[1, : 3 * width], boxes[2:]
    shorts = np.zeros((10 + 2 * over, 2 * wide), np.uint16)
    padded, middle = shorts[0, : 3 * (width + 2 * along - 2)], shorts[1, : 3 * (width + along - 1)]
    work, means, halo, cache = shorts[2:4], shorts[4, : 3 * width], shorts[5:8], shorts[8:]
    cached_rows = np.full(cache.shape[0], -1)
    tile = np.zeros(MOSAIC_SLOTS * TILE, np.float32)
    _design_rows(mosaic, rows, design)
    gains[:] = np.float32(1.0)
    blocks = (width + BLOCK - 1) // BLOCK
    flags, runs, n_runs = np.zeros(BLOCK * blocks + 16, np.uint8), np.zeros((blocks, 2), np.int32), np.int64(0)
    level = abs(nominal[3]) > abs(nominal[1])
    start = shared_row(max(low - REACH, 0))
    middle_row, entered = start - 1, start - over
    for y in range(max(low - REACH, 0), high + REACH):
        k = y % RING
        unit_re, unit_im = units[k, REACH : REACH + width], units[RING + k, REACH : REACH + width]
        if y < height:
            guess = _first_guess(image, y, mosaic, halo, cache, cached_rows)
            levels_of_row(guess, np.float32(1 / EIGHTHS), black, levels)
            if middle_row < shared_row(y):
                middle_row = shared_row(y)
                while entered < middle_row + over - 1:
                    entered += 1
                    keep = 1 if entered > start else 0
                    entering, leaving = mirrored(entered, height), mirrored(entered - keep * over, height)
                    advance(_first_guess(image, entering, mosaic, halo, cache, cached_rows),
                            _first_guess(image, leaving, mosaic, halo, cache, cached_rows), keep, drops[0],
                            drops[1], once, before[(entered - start) % over], twice)  # fmt: skip
                means_of_row(twice, along, drops[2], drops[3], padded, middle, work, means)
                balance_of_row(means, scale, black, unmix, balance)
                n_runs = gains_of_row(balance, colored_from, width, flags, runs, n_runs, gains)
            if low <= y < high:
                first, last = abs(y - 2), y + 2 if y + 2 < height else 2 * height - 4 - y
                above = _first_guess(image, first if level else y, mosaic, halo, cache, cached_rows)
                below = _first_guess(image, last if level else y, mosaic, halo, cache, cached_rows)
                equal_contrast(levels, above, below, level, mosaic[y & 1, 0], mosaic[y & 1, 1], black, width, equal)
                normalised_row(equal, balance, unmix, ideal, re, im, w)
                if table_step > 0:
                    correct_means(chromatic, table_step, y, re, im, w)
                    correct_phasors(chromatic, table_step, y, re, im)
                normalised_phase_row(re, im, descriptors[y])
                brightness_of_row(w, balance, brightness[y])
            rough_units(levels, solution, unit_re, unit_im, plain[k, :width])
            own_design[k] = n_runs > 0
            if n_runs > 0:
                even, odd = mosaic[y & 1, 0], mosaic[y & 1, 1]
                own = designs[3 * k : 3 * k + 3]
                for column in range(own.shape[1]):
                    for part in range(3):
                        own[part, column] = rows[odd if column & 1 else even, part]
                for run in range(n_runs):
                    e, f = runs[run, 0], runs[run, 1]
                    balanced_units(levels, gains, e, unmix, ideal, unit_re[e:f], unit_im[e:f], plain[k, e:f])
                    design_of_row(even, odd, mix, light, gains, e, f, own, REACH)
                if table_step > 0:
                    correct_design(chromatic, table_step, y, own, REACH)
            if table_step > 0:
                correct_phasors(chromatic, table_step, y, unit_re, unit_im)
                units_of_row(unit_re, unit_im)
            # The first guess of the outermost pixels, from pixels on one side of them, is about another place.
            continue_ends(units[k], units[RING + k], REACH + 1, REACH + width - 2, 2, nominal[0], nominal[1],
                          np.float32(AGREEING))  # fmt: skip
            count = samples_of_row(image[y], black[mosaic[y & 1, 0]], black[mosaic[y & 1, 1]], saturation,
                                   samples[k, REACH:], samples[RING + k, REACH:])  # fmt: skip
            if low <= y < high:
                saturated[y] = count
        else:
            samples[k::RING] = np.float32(0.0)
        if y == 2:
            _continue_row(units, 0, 1)
            _continue_row(units, -1, 1)
        if (y == height - 1) | (y == height):
            _continue_row(units, y, -1)
        i = y - REACH
        if low > i:
            continue
        if table_step > 0 and (i % DESIGN_ROWS == 0 or i == low):
            middle_of_rows = i - i % DESIGN_ROWS + DESIGN_ROWS // 2
            corrected_design(mosaic, rows, chromatic, table_step, middle_of_rows, design, REACH)
        p, q, r = (i - 1) % RING, i % RING, (i + 1) % RING
        for o in range(0, width, TILE):
            f, e = o + REACH, o + REACH + TILE
            start_tile(tile, units[p, f:e], units[RING + p, f:e], units[q, f - 1 : e - 1],
                       units[RING + q, f - 1 : e - 1], units[q, f:e], units[RING + q, f:e],
                       units[q, f + 1 : e + 1], units[RING + q, f + 1 : e + 1],
                       units[r, f:e], units[RING + r, f:e], nominal, radius)  # fmt: skip
            f, g = o, o + TILE + 2 * REACH
            for a in range(-radius, radius + 1):
                k, d = (i + a) % RING, 3 * ((i + a) & 1)
                weight, now = weights[abs(a)], design[d : d + 3]
                if own_design[k]:
                    now = designs[3 * k : 3 * k + 3]
                add_window_row(tile, units[k, f:g], units[RING + k, f:g], samples[k, f:g],
                               samples[RING + k, f:g], now[0, f:g], now[1, f:g], now[2, f:g],
                               weight * weights[0], weight * weights[1], weight * weights[2], floor,
                               gain)  # fmt: skip
            solve(tile)
            e = min(o + TILE, width)
            _write_tile(tile, units[q, o + REACH :], units[RING + q, o + REACH :], re[o:e], im[o:e], plain[q, o:e],
                        w[o:e])  # fmt: skip
        if own_design[q]:
            _widen_colored(designs[3 * q, REACH:], design[3 * (i & 1), REACH:], w)
        _widen_ends(w, (i == 0) | (i == height - 1))
        copy_row(w, variance[i])
        counts_of_row(plain[q, :width], mean[i])
        angles_of_row(re, im, PHASOR_SCALE, phasor[i], phase[i])
        describe_row(re, im, w, min_modulation, modulation[i], valid[i])
        complete_row(phase[i], valid[i], mean[i], descriptors[i])
