"""Mosaics: a first guess of all three colours, and the window fit on the raw samples, no demosaicing.

Every sample of the window obeys the equation of :mod:`pipeline.decode.kernels.normal_equations` with the design of its
own colour. Saturated samples are left out, and samples whose first guess does not continue the phase's plane (another
surface).
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from pipeline.common.jit import linked
from pipeline.common.tile_math import TILE
from pipeline.decode.kernels.normal_equations import SLOTS, accumulate, clear
from pipeline.decode.kernels.window_fit import step_of

CONSISTENT = 0.35  # cosine of the largest phase deviation inside a window
AGREEING = 0.2  # cosine of the largest difference of the steps to both sides; the first guess is noisy
EIGHTHS = 8  # the first guess is counted in eighths of a count, exactly
_X, _Y = SLOTS, SLOTS + 2  # phasors of the phase's steps
_ROW = SLOTS + 4  # predicted phasors at the first pixel of the current window row
MOSAIC_SLOTS = SLOTS + 6


@linked
def padded_row(raw: Any, out: Any) -> None:
    """Copy raw (W,) uint8 to out (W + 2,) uint16, mirrored at the border pixels, which keeps the parity."""
    n = raw.shape[0]
    inner = out[1:]
    for j in range(n):
        inner[j] = np.uint16(raw[j])
    out[0], out[n + 1] = out[2], out[n - 1]


@linked
def rough_row(above: Any, middle: Any, below: Any, even: int, odd: int, out: Any) -> None:
    """First guess: each colour's weighted mean over 3 x 3 pixels (weights 1 2 1 both ways), in eighths of a count.

    Args:
        above, middle, below: (W + 2,) uint16, see :func:`padded_row`; even, odd: colours at this row's columns.
        out: (3 W,) uint16, colours interleaved.
    """
    own = odd if even == 1 else even  # the colour in this row that is not green
    other = 2 - own
    green = 0 if even == 1 else 1  # parity of the columns with green
    n = out.shape[0] // 3
    first, last, above_last, below_last = middle[1:], middle[2:], above[2:], below[2:]
    up, down = above[1:], below[1:]
    for j in range(n):
        is_green = (j & 1) == green
        beside, over = middle[j] + last[j], up[j] + down[j]
        corners = above[j] + above_last[j] + below[j] + below_last[j]
        out[3 * j + 1] = np.uint16(4 * first[j] + corners if is_green else 2 * (beside + over))
        out[3 * j + own] = np.uint16(4 * beside if is_green else 8 * first[j])
        out[3 * j + other] = np.uint16(4 * over if is_green else 2 * corners)


@linked
def equal_contrast(
    levels: Any, above: Any, below: Any, level: bool, even: int, odd: int, black: Any, n: int, out: Any
) -> None:  # fmt: skip
    """Levels (3, W or more) of the first guess with the same contrast everywhere, as the normalised phase needs.

    The mean of the samples on both sides of a pixel has less contrast by cos(step of the phase) than its own sample,
    and the mean of both kinds, which green is, by half as much: the phase would have an error of twice its frequency
    that changes its sign from pixel to pixel. So what is two pixels away is mixed in: 1 6 1 into a pixel's own sample,
    1 14 1 into green. All then lose as much, up to the fourth power of the step.

    Args:
        above, below: (3 W,) uint16, first guess of the rows two above and below, which matter for level fringes only.
        level: the phase grows from row to row; even, odd: colours at this row's columns; black: (3,) counts; n: W.
    """
    own = odd if even == 1 else even  # the colour in this row that is not green
    other = 2 - own
    green = 0 if even == 1 else 1  # parity of the columns with green
    if level:
        _mix_rows(levels[own, :n], above[own::3], below[own::3], black[own], np.float32(6), out[own, :n])
        _mix_rows(levels[1, :n], above[1::3], below[1::3], black[1], np.float32(14), out[1, :n])
        row, to = levels[other, :n], out[other, :n]
        for j in range(n):
            to[j] = row[j]
        return
    _mix_columns(levels[own, :n], np.float32(6), 1 - green, 1 - green, out[own, :n])
    _mix_columns(levels[other, :n], np.float32(6), green, green, out[other, :n])
    _mix_columns(levels[1, :n], np.float32(14), 0, 1, out[1, :n])


@linked
def _mix_columns(row: Any, weight: float, first: int, second: int, out: Any) -> None:
    """A row (n,) with what is two columns away mixed in, in columns of the parities ``first`` and ``second``."""
    n, part = row.shape[0], np.float32(1) / (weight + np.float32(2))
    for j in range(2):
        out[j], out[n - 1 - j] = row[j], row[n - 1 - j]
    behind, middle, ahead, inner = row[: n - 4], row[2 : n - 2], row[4:], out[2 : n - 2]
    for j in range(inner.shape[0]):
        mixed = (behind[j] + weight * middle[j] + ahead[j]) * part
        inner[j] = mixed if ((j & 1) == first) | ((j & 1) == second) else middle[j]


@linked
def _mix_rows(row: Any, above: Any, below: Any, black: float, weight: float, out: Any) -> None:
    """A row (n,) with what is two rows away mixed in: above, below (n,) uint16, first guesses in eighths of a count."""
    part, unit = np.float32(1) / (weight + np.float32(2)), np.float32(1 / EIGHTHS)
    for j in range(out.shape[0]):
        far = np.float32(np.int32(above[j]) + np.int32(below[j])) * unit - np.float32(2) * black
        out[j] = (weight * row[j] + far) * part


@linked
def rough_units(levels: Any, solution: Any, re: Any, im: Any, mean: Any) -> None:
    """Unit phasors and mean (W,) of the first guess, levels (3, W or more) counts above black."""
    zero, one, tiny = np.float32(0.0), np.float32(1.0), np.float32(1e-12)
    a0, a1, a2 = solution[0, 0], solution[0, 1], solution[0, 2]
    c0, c1, c2 = solution[1, 0], solution[1, 1], solution[1, 2]
    s0, s1, s2 = solution[2, 0], solution[2, 1], solution[2, 2]
    n = re.shape[0]
    row_x, row_y, row_z = levels[0, :n], levels[1, :n], levels[2, :n]
    for j in range(n):
        x, y, z = row_x[j], row_y[j], row_z[j]
        c, s = c0 * x + c1 * y + c2 * z, s0 * x + s1 * y + s2 * z
        inverse = one / np.float32(sqrt(c * c + s * s + tiny))
        re[j], im[j] = c * inverse, s * inverse
        mean[j] = max(a0 * x + a1 * y + a2 * z, zero)


@linked
def samples_of_row(raw: Any, even: float, odd: float, saturation: float, level: Any, usable: Any) -> int:
    """Counts above black (``even``, ``odd``) of raw (W,) uint8, and 0 where saturated, else 1; returns how many are."""
    one, zero = np.float32(1.0), np.float32(0.0)
    saturated = zero
    for j in range(raw.shape[0]):
        x = np.float32(raw[j])
        fine = one if x < saturation else zero
        level[j], usable[j] = x - (odd if j & 1 else even), fine
        saturated += one - fine
    return int(saturated)


@linked
def start_tile(
    tile: Any, above_re: Any, above_im: Any, before_re: Any, before_im: Any, re: Any, im: Any, after_re: Any,
    after_im: Any, below_re: Any, below_im: Any, nominal: Any, radius: int,
) -> None:  # fmt: skip
    """Steps of the phase at (TILE,) pixels and the phasor predicted at the window's first pixel, from unit phasors."""
    xc, xs, yc, ys, agreeing = nominal[0], nominal[1], nominal[2], nominal[3], np.float32(AGREEING)
    for j in range(TILE):
        c, s, _, _ = step_of(before_re[j], before_im[j], re[j], im[j], after_re[j], after_im[j], xc, xs, agreeing)
        tile[_X * TILE + j], tile[(_X + 1) * TILE + j] = c, s
    for j in range(TILE):
        c, s, _, _ = step_of(above_re[j], above_im[j], re[j], im[j], below_re[j], below_im[j], yc, ys, agreeing)
        tile[_Y * TILE + j], tile[(_Y + 1) * TILE + j] = c, s
    for j in range(TILE):
        tile[_ROW * TILE + j], tile[(_ROW + 1) * TILE + j] = re[j], im[j]
    for k in range(2):
        for j in range(TILE):
            c, s = tile[_X * TILE + j], tile[(_X + 1) * TILE + j]
            p, q = tile[_ROW * TILE + j], tile[(_ROW + 1) * TILE + j]
            p, q = p * c + q * s, q * c - p * s
            c, s = tile[_Y * TILE + j], tile[(_Y + 1) * TILE + j]
            up = k < radius
            tile[_ROW * TILE + j] = p * c + q * s if up else p
            tile[(_ROW + 1) * TILE + j] = q * c - p * s if up else q
    clear(tile)


@linked
def add_window_row(
    tile: Any, re: Any, im: Any, level: Any, usable: Any, a: Any, p: Any, q: Any, middle: float, side: float,
    far: float, floor: float, gain: float,
) -> None:  # fmt: skip
    """Add a row of the window, five samples, to every pixel, and predict the phasors of the next row.

    All five in one loop, everything loaded before anything is stored: the sums stay in registers in between.

    Args:
        re, im: (TILE + 4,) unit phasors from two columns before the tile on; level, usable: see
            :func:`samples_of_row`; a, p, q: design of the columns.
        middle, side, far: weights of the samples by the distance of their columns.
    """
    zero, least = np.float32(0.0), np.float32(CONSISTENT)
    for j in range(TILE):
        c0, s0 = tile[_ROW * TILE + j], tile[(_ROW + 1) * TILE + j]
        x, y = tile[_X * TILE + j], tile[(_X + 1) * TILE + j]
        v, w = tile[_Y * TILE + j], tile[(_Y + 1) * TILE + j]
        c1, s1 = c0 * x - s0 * y, s0 * x + c0 * y
        c2, s2 = c1 * x - s1 * y, s1 * x + c1 * y
        c3, s3 = c2 * x - s2 * y, s2 * x + c2 * y
        c4, s4 = c3 * x - s3 * y, s3 * x + c3 * y
        # Columns two apart have the same colour.
        a0, p0, q0, a1, p1, q1 = a[j], p[j], q[j], a[j + 1], p[j + 1], q[j + 1]
        l0, l1, l2, l3, l4 = level[j], level[j + 1], level[j + 2], level[j + 3], level[j + 4]
        w0 = far * usable[j] if c0 * re[j] + s0 * im[j] >= least else zero
        w1 = side * usable[j + 1] if c1 * re[j + 1] + s1 * im[j + 1] >= least else zero
        w2 = middle * usable[j + 2] if c2 * re[j + 2] + s2 * im[j + 2] >= least else zero
        w3 = side * usable[j + 3] if c3 * re[j + 3] + s3 * im[j + 3] >= least else zero
        w4 = far * usable[j + 4] if c4 * re[j + 4] + s4 * im[j + 4] >= least else zero
        tile[_ROW * TILE + j], tile[(_ROW + 1) * TILE + j] = c0 * v - s0 * w, s0 * v + c0 * w
        accumulate(tile, j, a0, p0 * c0 + q0 * s0, q0 * c0 - p0 * s0, l0, w0, floor + gain * max(l0, zero))
        accumulate(tile, j, a1, p1 * c1 + q1 * s1, q1 * c1 - p1 * s1, l1, w1, floor + gain * max(l1, zero))
        accumulate(tile, j, a0, p0 * c2 + q0 * s2, q0 * c2 - p0 * s2, l2, w2, floor + gain * max(l2, zero))
        accumulate(tile, j, a1, p1 * c3 + q1 * s3, q1 * c3 - p1 * s3, l3, w3, floor + gain * max(l3, zero))
        accumulate(tile, j, a0, p0 * c4 + q0 * s4, q0 * c4 - p0 * s4, l4, w4, floor + gain * max(l4, zero))
