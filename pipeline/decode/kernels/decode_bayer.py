"""Decoding of a mosaic in one pass over bands of rows; three chips: :mod:`pipeline.decode.kernels.decode_rgb`."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel
from pipeline.common.tile_math import TILE
from pipeline.decode.kernels.chromatic_correction import (
    DESIGN_ROWS,
    correct_design,
    correct_phasors,
    corrected_design,
    units_of_row,
)
from pipeline.decode.kernels.color_gains import BLOCK, balanced_units, design_of_row, gains_of_row
from pipeline.decode.kernels.decode_rgb import BANDS
from pipeline.decode.kernels.local_mean import advance, means_of_row, mirrored, shared_row
from pipeline.decode.kernels.local_normalisation import balance_of_row, normalised_row
from pipeline.decode.kernels.mosaic_fit import (
    EIGHTHS,
    MOSAIC_SLOTS,
    add_window_row,
    padded_row,
    rough_row,
    rough_units,
    samples_of_row,
    start_tile,
)
from pipeline.decode.kernels.normal_equations import IM, MEAN, RE, VARIANCE, solve
from pipeline.decode.kernels.row_output import angles_of_row, copy_row, counts_of_row, describe_row, row_stride
from pipeline.decode.kernels.three_step import levels_of_row
from pipeline.decode.packed_phasor import PHASOR_SCALE
from pipeline.decode.pixel_descriptor import complete_row, normalised_phase_row

COLORED = 1.7
"""Factor of the variance on strong colours, whose first guess is noisier: without it errors were 1.2 times sigma."""


@serial
def _design_rows(mosaic: Any, rows: Any, out: Any) -> None:
    """Design (a, p, q) of every column's colour in even and odd rows, out (6, ...)."""
    for k in range(6):
        for j in range(out.shape[1]):
            out[k, j] = rows[mosaic[k // 3, j & 1], k % 3]


@serial
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


@serial
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


@serial
def _widen_colored(own: Any, plain: Any, variance: Any) -> None:
    """Raise the variance of a row (n,) where the design's first number is not that of a surface without gains."""
    one, factor, least = np.float32(1.0), np.float32(COLORED), np.float32(1e-4)
    for j in range(variance.shape[0]):
        variance[j] *= factor if abs(own[j] - plain[j]) > least else one


@parallel
def decode_bayer(
    band: int, image: Any, mosaic: Any, rows: Any, black: Any, solution: Any, mix: Any, light: Any, unmix: Any,
    ideal: Any, weights: Any, radius: int, nominal: Any, saturation: float, floor: float, gain: float,
    min_modulation: float, along: int, over: int, drops: Any, scale: float, colored_from: Any, chromatic: Any,
    table_step: int, phasor: Any, descriptors: Any, mean: Any, variance: Any, phase: Any, modulation: Any, valid: Any,
    saturated: Any,
) -> None:  # fmt: skip
    """Fill the planes of a :class:`pipeline.decode.decoder.PhaseMap`; image (H, W) uint8, mosaic (2, 2) channels.

    ``rows`` (3, 3) is the design of the channels; all else as in :func:`pipeline.decode.kernels.decode_rgb.decode_rgb`.
    """
    height, width = mean.shape
    ring, edge = 2 * radius + 1, radius + 1
    inf, zero = np.float32(np.inf), np.float32(0.0)
    # A tile may extend beyond the end of a row.
    stride = row_stride(width + TILE + 4)
    wide = row_stride(3 * width + 6 * along)
    low, high = band * height // BANDS, (band + 1) * height // BANDS
    slab = np.zeros((8 * ring + 18, stride), np.float32)
    levels, design = slab[0:3], slab[3:9]
    re, im, w = slab[9, :width], slab[10, :width], slab[11, :width]
    balance, units, samples = slab[12:15], slab[15 : 15 + 2 * ring], slab[15 + 2 * ring : 15 + 4 * ring]
    plain, gains = slab[15 + 4 * ring : 15 + 5 * ring], slab[15 + 5 * ring : 18 + 5 * ring]
    designs, own_design = slab[18 + 5 * ring :], np.zeros(ring, np.bool_)  # of rows with strong colours
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
    flags, runs, n_runs = np.zeros(BLOCK * blocks + 16, np.uint8), np.zeros((blocks, 2), np.int32), 0
    start = shared_row(max(low - radius, 0))
    middle_row, entered = start - 1, start - over
    for y in range(max(low - radius, 0), min(high + radius, height)):
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
            normalised_row(levels, balance, unmix, ideal, re, im)
            if table_step > 0:
                correct_phasors(chromatic, table_step, y, re, im)
            normalised_phase_row(re, im, descriptors[y])
        k = y % ring
        rough_units(levels, solution, units[k, :width], units[ring + k, :width], plain[k, :width])
        own_design[k] = n_runs > 0
        if n_runs > 0:
            even, odd, own = mosaic[y & 1, 0], mosaic[y & 1, 1], designs[3 * k : 3 * k + 3]
            for column in range(own.shape[1]):
                for part in range(3):
                    own[part, column] = rows[odd if column & 1 else even, part]
            for run in range(n_runs):
                e, f = runs[run, 0], runs[run, 1]
                balanced_units(levels, gains, e, unmix, ideal, units[k, e:f], units[ring + k, e:f],
                               plain[k, e:f])  # fmt: skip
                design_of_row(even, odd, mix, light, gains, e, f, own)
            if table_step > 0:
                correct_design(chromatic, table_step, y, own)
        if table_step > 0:
            correct_phasors(chromatic, table_step, y, units[k, :width], units[ring + k, :width])
            units_of_row(units[k, :width], units[ring + k, :width])
        n_saturated = samples_of_row(image[y], black[mosaic[y & 1, 0]], black[mosaic[y & 1, 1]], saturation,
                                     samples[k], samples[ring + k])  # fmt: skip
        if low <= y < high:
            saturated[y] = n_saturated
            if y < edge or y >= height - edge:
                phasor[y, :], phase[y, :], variance[y, :], modulation[y, :], valid[y, :] = 0, zero, inf, 0, False
                counts_of_row(plain[k, :width], mean[y])
                complete_row(phase[y], valid[y], mean[y], descriptors[y])
        i = y - radius
        if table_step > 0 and low <= i and (i % DESIGN_ROWS == 0 or i == low):
            corrected_design(mosaic, rows, chromatic, table_step, i - i % DESIGN_ROWS + DESIGN_ROWS // 2, design)
        if low <= i and edge <= i < height - edge:
            p, q, r = (i - 1) % ring, i % ring, (i + 1) % ring
            for o in range(edge, width - edge, TILE):
                e = o + TILE
                start_tile(tile, units[p, o:e], units[ring + p, o:e], units[q, o - 1 : e - 1],
                           units[ring + q, o - 1 : e - 1], units[q, o:e], units[ring + q, o:e],
                           units[q, o + 1 : e + 1], units[ring + q, o + 1 : e + 1],
                           units[r, o:e], units[ring + r, o:e], nominal, radius)  # fmt: skip
                for a in range(-radius, radius + 1):
                    k, d, f, g = (i + a) % ring, 3 * ((i + a) & 1), o - 2, e + 2
                    weight, now = weights[abs(a)], design[d : d + 3]
                    if own_design[k]:
                        now = designs[3 * k : 3 * k + 3]
                    add_window_row(tile, units[k, f:g], units[ring + k, f:g], samples[k, f:g],
                                   samples[ring + k, f:g], now[0, f:g], now[1, f:g], now[2, f:g],
                                   weight * weights[0], weight * weights[1], weight * weights[2], floor,
                                   gain)  # fmt: skip
                solve(tile)
                e = min(e, width - edge)
                _write_tile(tile, units[q, o:e], units[ring + q, o:e], re[o:e], im[o:e], plain[q, o:e], w[o:e])
            if own_design[q]:
                _widen_colored(designs[3 * q], design[3 * (i & 1)], w)
            for j in range(edge):
                for x in (j, width - 1 - j):
                    re[x], im[x], w[x] = zero, zero, inf
            copy_row(w, variance[i])
            counts_of_row(plain[q, :width], mean[i])
            angles_of_row(re, im, PHASOR_SCALE, phasor[i], phase[i])
            describe_row(re, im, w, min_modulation, modulation[i], valid[i])
            complete_row(phase[i], valid[i], mean[i], descriptors[i])
