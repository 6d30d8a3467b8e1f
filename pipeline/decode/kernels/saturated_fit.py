"""Window fit of pixels of a three-chip image with a saturated sample, from the unsaturated samples.

The saturated pixels of a row are gathered into tiles, fitted by the full normal equations and written back.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, linked, serial
from pipeline.common.tile_math import TILE
from pipeline.decode.kernels.color_gains import design_of
from pipeline.decode.kernels.normal_equations import IM, MEAN, RE, SLOTS, VARIANCE, accumulate, clear, solve
from pipeline.decode.kernels.window_fit import AGREEING, step_of

_UNITS = SLOTS  # unit phasors of the pixel and its neighbours left, right, above, below: 5 x (re, im)
_STEP_X, _STEP_Y = _UNITS + 10, _UNITS + 12  # phasors of the phase's steps
_TURN = _UNITS + 14
_RAW = _UNITS + 16
_DESIGN = _UNITS + 17  # (a, p, q) of the three channels
SATURATED_SLOTS = _UNITS + 26


@linked
def saturated_of_row(raw: Any, saturation: float, found: Any) -> int:
    """Columns with a saturated sample into ``found`` (W + 1,); returns how many; raw (3 W,) is interleaved."""
    n = 0
    for j in range(raw.shape[0] // 3):
        found[n] = j
        n += (raw[3 * j] >= saturation) | (raw[3 * j + 1] >= saturation) | (raw[3 * j + 2] >= saturation)
    return n


@linked
def plain_mean(raw: Any, j: int, black: Any, solution: Any) -> Any:
    """Mean A of a single pixel of a row, counts."""
    a = np.float32(0.0)
    for k in range(3):
        a += solution[0, k] * (np.float32(raw[3 * j + k]) - black[k])
    return max(a, np.float32(0.0))


@inline
def _power(c: float, s: float, n: int) -> Any:
    """Power -2 ... 2 of a unit phasor."""
    two, none = (n == 2) | (n == -2), n == 0
    a, b = (c * c - s * s if two else c), (s * c + c * s if two else s)
    re, im = (np.float32(1.0) if none else a), (np.float32(0.0) if none else b)
    return re, (-im if n < 0 else im)


@serial
def _turn(tile: Any, row: int, column: int) -> None:
    """Phasor of the phase's change from the pixel to its neighbour some rows and columns (at most two) away."""
    for j in range(TILE):
        a, b = _power(tile[_STEP_X * TILE + j], tile[(_STEP_X + 1) * TILE + j], column)
        c, s = _power(tile[_STEP_Y * TILE + j], tile[(_STEP_Y + 1) * TILE + j], row)
        tile[_TURN * TILE + j], tile[(_TURN + 1) * TILE + j] = a * c - b * s, b * c + a * s


@inline
def _step(tile: Any, back: int, xc: Any, xs: Any, out: int) -> None:
    """Steps from the unit phasors of slots ``back`` and ``back + 2`` (behind, ahead) to slot ``out``."""
    agreeing = np.float32(AGREEING)
    for j in range(TILE):
        re, im = tile[_UNITS * TILE + j], tile[(_UNITS + 1) * TILE + j]
        p, q = tile[back * TILE + j], tile[(back + 1) * TILE + j]
        v, w = tile[(back + 2) * TILE + j], tile[(back + 3) * TILE + j]
        c, s, _, _ = step_of(p, q, re, im, v, w, xc, xs, agreeing)
        tile[out * TILE + j], tile[(out + 1) * TILE + j] = c, s


@serial
def _steps(tile: Any, nominal: Any) -> None:
    _step(tile, _UNITS + 2, nominal[0], nominal[1], _STEP_X)
    _step(tile, _UNITS + 6, nominal[2], nominal[3], _STEP_Y)


@linked
def _add_channel(
    tile: Any, channel: int, dark: float, saturation: float, weight: float, floor: float, gain: float
) -> None:
    """Add one sample of every pixel; a saturated one has weight 0."""
    zero, first = np.float32(0.0), (_DESIGN + 3 * channel) * TILE
    for j in range(TILE):
        a, p, q = tile[first + j], tile[first + TILE + j], tile[first + 2 * TILE + j]
        raw, c, s = tile[_RAW * TILE + j], tile[_TURN * TILE + j], tile[(_TURN + 1) * TILE + j]
        level = raw - dark
        accumulate(tile, j, a, p * c + q * s, q * c - p * s, level, weight if raw < saturation else zero,
                   floor + gain * max(level, zero))  # fmt: skip


@linked
def fit_saturated(
    image: Any, i: int, columns: Any, radius: int, nominal: Any, weights: Any, mix: Any, light: Any, gains: Any,
    black: Any, saturation: float, floor: float, gain: float, units: Any, tile: Any, re: Any, im: Any, mean: Any,
    variance: Any,
) -> None:  # fmt: skip
    """Fit up to TILE pixels of row ``i``; results into those elements of re, im, mean, variance (W,).

    Args:
        image: (H, 3 W) uint8; columns: (n,) of the pixels.
        nominal: (4,) expected steps; weights: (3,) by distance.
        mix, light, gains: of :func:`pipeline.decode.kernels.color_gains.design_of`.
        units: unit phasors' re, im of the rows above, at and below the pixels, (W + 2 max(radius, 1) or more,): a
            window is not cut at the ends of the rows.
    """
    above_re, above_im, row_re, row_im, below_re, below_im = units
    n, height, width = columns.shape[0], image.shape[0], image.shape[1] // 3
    for j in range(n):
        x = columns[j] + max(radius, 1)
        tile[_UNITS * TILE + j], tile[(_UNITS + 1) * TILE + j] = row_re[x], row_im[x]
        tile[(_UNITS + 2) * TILE + j], tile[(_UNITS + 3) * TILE + j] = row_re[x - 1], row_im[x - 1]
        tile[(_UNITS + 4) * TILE + j], tile[(_UNITS + 5) * TILE + j] = row_re[x + 1], row_im[x + 1]
        tile[(_UNITS + 6) * TILE + j], tile[(_UNITS + 7) * TILE + j] = above_re[x], above_im[x]
        tile[(_UNITS + 8) * TILE + j], tile[(_UNITS + 9) * TILE + j] = below_re[x], below_im[x]
        for k in range(3):
            a, p, q = design_of(mix, light, gains, k, columns[j])
            o = (_DESIGN + 3 * k) * TILE + j
            tile[o], tile[o + TILE], tile[o + 2 * TILE] = a, p, q
    _steps(tile, nominal)
    clear(tile)
    for a in range(max(-radius, -i), min(radius + 1, height - i)):
        raw = image[i + a]
        for b in range(-radius, radius + 1):
            _turn(tile, a, b)
            for k in range(3):
                for j in range(n):
                    x = columns[j] + b
                    inside = (x >= 0) & (x < width)
                    tile[_RAW * TILE + j] = np.float32(raw[3 * x + k]) if inside else np.float32(saturation)
                _add_channel(tile, k, black[k], saturation, weights[abs(a)] * weights[abs(b)], floor, gain)
    solve(tile)
    for j in range(n):
        x = columns[j]
        if tile[VARIANCE * TILE + j] < np.float32(np.inf):
            mean[x] = min(max(tile[MEAN * TILE + j], np.float32(0.0)), np.float32(1024.0))
        re[x], im[x], variance[x] = tile[RE * TILE + j], tile[IM * TILE + j], tile[VARIANCE * TILE + j]
