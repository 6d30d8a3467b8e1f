"""Fringe-free colour of every pixel: the channels' local means, scaled by the pointwise brightness.

Each channel divided by its mean over one fringe period (:mod:`pipeline.decode.kernels.local_mean`) is
``r (1 + m cos(Phi + shift))`` with one r for all three: the channels' reflectances are in their means. The mean of the
three-step solution of these quotients is r, the brightness of the pixel relative to its surroundings, without fringes.
Colour is therefore blurred over a period, brightness is as sharp as the image. Within a period of the image's edges,
where the mean would lack a part of the fringe, colour is that of the nearest complete mean.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked, serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.decode.kernels.chromatic_correction import correct_means
from pipeline.decode.kernels.local_mean import advance, means_of_row, mirrored, shared_row
from pipeline.decode.kernels.local_normalisation import balance_of_row, normalised_row
from pipeline.decode.kernels.mosaic_fit import padded_row, rough_row
from pipeline.decode.kernels.row_output import row_stride
from pipeline.decode.kernels.three_step import levels_of_row

BANDS = 12
_HALF, _MOST = np.float32(0.5), np.float32(255)


@parallel_allocating
def rough_colors(y: int, image: Any, mosaic: Any, out: Any) -> None:
    """All three colours of row y of a mosaic (H, W) uint8, in eighths of a count: out (H, 3 W) uint16."""
    height, width = image.shape
    padded = np.empty((3, width + 2), np.uint16)
    for k in range(3):
        i = abs(y + k - 1)
        padded_row(image[i if i < height else 2 * height - 2 - i], padded[k])
    rough_row(padded[0], padded[1], padded[2], mosaic[y & 1, 0], mosaic[y & 1, 1], out[y])


@serial
def _complete(i: int, extent: int, n: int) -> int:
    """The nearest of n elements with all of the double box inside; the middle one if there is none."""
    first = min(extent - 1, n // 2)
    return min(max(i, first), max(n - 1 - first, first))


@serial
def _extend(means: Any, along: int) -> None:
    """Replace means (3 W,) whose box is not complete by the nearest complete one."""
    n = means.shape[0] // 3
    first, last = _complete(0, along, n), _complete(n - 1, along, n)
    for k in range(3):
        for j in range(first):
            means[3 * j + k] = means[3 * first + k]
        for j in range(last + 1, n):
            means[3 * j + k] = means[3 * last + k]


@linked
def _colors_of_row(brightness: Any, balance: Any, out: Any) -> None:
    """Brightness (W,) times the channels' means, out (3 W,) uint8."""
    n = brightness.shape[0]
    by0, by1, by2 = balance[0, :n], balance[1, :n], balance[2, :n]
    for j in range(n):
        b = brightness[j]
        out[3 * j] = np.uint8(np.int32(min(b / by0[j] + _HALF, _MOST)))
        out[3 * j + 1] = np.uint8(np.int32(min(b / by1[j] + _HALF, _MOST)))
        out[3 * j + 2] = np.uint8(np.int32(min(b / by2[j] + _HALF, _MOST)))


@parallel_allocating
def color_texture(
    band: int, image: Any, unit: float, black: Any, unmix: Any, ideal: Any, along: int, over: int, drops: Any,
    scale: float, chromatic: Any, table_step: int, out: Any,
) -> None:  # fmt: skip
    """Colours of a band of rows.

    Args:
        image: (H, 3 W) uint8 or uint16, colours interleaved, in steps of ``unit`` counts.
        out: (H, 3 W) uint8, result; all others as in :func:`pipeline.decode.kernels.decode_rgb.decode_rgb`.
    """
    height, width = image.shape[0], image.shape[1] // 3
    wide = row_stride(3 * width + 6 * along)
    low, high = band * height // BANDS, (band + 1) * height // BANDS
    slab = np.zeros((10, row_stride(width)), np.float32)
    levels, balance = slab[0:3], slab[3:7]
    re, im, brightness = slab[7, :width], slab[8, :width], slab[9, :width]
    boxes = np.zeros((2 + over, wide), np.uint16)
    once, twice, before = boxes[0, : 3 * width], boxes[1, : 3 * width], boxes[2:]
    shorts = np.zeros((5, 2 * wide), np.uint16)
    padded, middle = shorts[0, : 3 * (width + 2 * along - 2)], shorts[1, : 3 * (width + along - 1)]
    work, means = shorts[2:4], shorts[4, : 3 * width]
    start = _complete(shared_row(low), over, height)
    middle_row, entered = start - 1, start - over
    for y in range(low, high):
        if middle_row < _complete(shared_row(y), over, height):
            middle_row = _complete(shared_row(y), over, height)
            while entered < middle_row + over - 1:
                entered += 1
                keep = 1 if entered > start else 0
                leaving = mirrored(entered - keep * over, height)
                advance(image[mirrored(entered, height)], image[leaving], keep, drops[0], drops[1], once,
                        before[(entered - start) % over], twice)  # fmt: skip
            means_of_row(twice, along, drops[2], drops[3], padded, middle, work, means)
            _extend(means, along)
            balance_of_row(means, scale, black, unmix, balance)
        levels_of_row(image[y], unit, black, levels)
        normalised_row(levels, balance, unmix, ideal, re, im, brightness)
        if table_step > 0:
            correct_means(chromatic, table_step, y, re, im, brightness)
        _colors_of_row(brightness, balance, out[y])
