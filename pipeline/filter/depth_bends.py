"""What sharp bends of the depth add to the standard deviation of a point.

The phase of a pixel is fitted from a window. Where the window straddles two surfaces a few millimetres apart, or where
one of the cameras sees the end of a surface, the points between are wrong by up to the step, and neither the noise nor
the textures show it. The depth does: a point that lies off the straight line through its neighbours by more than their
noise explains has probably that error itself.

Two second differences along the rows and two along the columns: of the points :data:`NEAR` pixels away on both sides,
and, within :data:`FAR` pixels of the end of a surface, of the points farther inside. Independent noise gives a variance
of 6 sigma^2. Direct neighbours show no bend where a step has become a slope, and one side of it is inclined nearly as
much. Points whose depth differs by more than half a fringe order belong to another surface: a mixture of such phases
does not lie between both.

A window that straddles a step makes a slope of it that is several pixels wide. The depth bends at both ends of the
slope and the errors are largest between them, so a bend counts for the points within :data:`SPREAD` pixels, too.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import inline, linked
from pipeline.common.parallel_for import blocks, parallel_allocating
from pipeline.filter.blurred_steps import steps_of_row
from pipeline.filter.depth_clusters import link_row

F32 = NDArray[np.float32]

ROWS = 32
"""Rows that are processed together."""
NEAR, FAR = 2, 3
"""Distance of the points on both sides, pixels (with a stride, one measured pixel at least), and of those farther
inside; the second of these is twice as far."""
SHARE, NOISE, END_NOISE = np.float32(0.5), np.float32(81.0), np.float32(36.0)
"""Share of the squared difference that becomes variance, and how many variances of the point are taken as noise, the
last at the end of a surface: with 36 everywhere error / sigma inside of surfaces is 0.95 instead of 1.00."""
SPREAD = 2
"""Distance along rows and columns up to which a bend raises the standard deviation, pixels (with a stride, one measured
pixel at least)."""
CLEAR = np.float32(9.0)
"""Variances of a point that a bend must add before it counts for points beside it: three standard deviations of noise
have less, and would spread over nine points each."""
_REACH = 2 * FAR
_NAN, _ZERO, _TWO = np.float32(np.nan), np.float32(0.0), np.float32(2.0)


class DepthSteps(NamedTuple):
    """Steps of the depth along rows and columns, by depth.

    Args:
        least: of :func:`pipeline.filter.blurred_steps.least_step`.
        most: of :func:`pipeline.filter.depth_clusters.largest_step`.
    """

    least: tuple[np.float32, np.float32]
    most: tuple[np.float32, np.float32]


@inline
def _same(depth: Any, here: Any, most: Any) -> Any:
    """A neighbour's depth, NaN where it is unknown or of another surface."""
    return depth if abs(depth - here) <= most else _NAN


@inline
def _beyond(difference: Any, noise: Any) -> Any:
    """Square of a second difference beyond the noise, 0 where it is unknown."""
    square = difference * difference - noise
    return square if square > _ZERO else _ZERO


@linked
def _add_bends(z: Any, before: Any, after: Any, most: Any, variance: Any, more: Any) -> None:
    """Add the bends of a row to ``more`` (W,).

    Args:
        before, after: (W,) depth at NEAR pixels, NaN if unknown; most: (W,) largest step within a surface.
        variance: (W,) of the points.
    """
    for j in range(more.shape[0]):
        here, limit = z[j], most[j]
        bend = _same(before[j], here, limit) - _TWO * here + _same(after[j], here, limit)
        more[j] += _beyond(bend, NOISE * variance[j])


@linked
def _add_ends(
    z: Any, before: Any, after: Any, farther: Any, beyond: Any, most: Any, variance: Any, more: Any
) -> None:  # fmt: skip
    """Add what the points farther inside show of those that lack a neighbour at :data:`FAR` pixels on one side.

    Args:
        before, after: (W,) depth at FAR pixels; farther, beyond: before and after at twice that.
    """
    for j in range(more.shape[0]):
        here, limit = z[j], most[j]
        first, second = _same(before[j], here, limit), _same(after[j], here, limit)
        one = here - _TWO * first + _same(farther[j], here, limit)
        other = here - _TWO * second + _same(beyond[j], here, limit)
        both = first - second
        inside = other if other == other else one
        more[j] += _beyond(_ZERO if both == both else inside, END_NOISE * variance[j])


@linked
def _copy_depth(xyz: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        out[j] = xyz[j, 2]


@linked
def _bends_of_row(depth: Any, k: int, near: int, half_order: Any, sigma: Any, rows: Any, out: Any) -> None:
    """Variance (W,) that the bends of row k of ``depth`` add, which has a border of unknown points.

    Args:
        near: distance of the points on both sides; sigma: (W,) of the row; rows: (2, W), scratch.
    """
    end = _REACH + sigma.shape[0]
    row, z = depth[k], depth[k, _REACH:end]
    most, variance = rows[0], rows[1]
    for j in range(sigma.shape[0]):
        most[j], variance[j], out[j] = half_order * z[j] * z[j], sigma[j] * sigma[j], _ZERO
    _add_bends(z, row[_REACH - near : end - near], row[_REACH + near : end + near], most, variance, out)
    _add_bends(z, depth[k - near, _REACH:end], depth[k + near, _REACH:end], most, variance, out)
    _add_ends(z, row[_REACH - FAR : end - FAR], row[_REACH + FAR : end + FAR], row[: end - _REACH],
              row[2 * _REACH :], most, variance, out)  # fmt: skip
    _add_ends(z, depth[k - FAR, _REACH:end], depth[k + FAR, _REACH:end], depth[k - _REACH, _REACH:end],
              depth[k + _REACH, _REACH:end], most, variance, out)  # fmt: skip
    for j in range(sigma.shape[0]):
        out[j] *= SHARE


@parallel_allocating
def _bends(
    block: int, stride: int, per_order: Any, least: Any, most: Any, xyz: Any, sigma: Any, bends: Any, known: Any,
    link: Any,
) -> None:  # fmt: skip
    """Variance that the bends of :data:`ROWS` rows of measured pixels add; arguments as of :func:`widen_at_bends`."""
    height, width = bends.shape[0] - 2 * SPREAD, bends.shape[1] - 2 * SPREAD
    half_order, near = np.float32(0.5) * per_order, max(NEAR // stride, 1)
    top = block * ROWS
    bottom = min(top + ROWS, height)
    # With a border of unknown points no access needs a test for the image's end.
    depth = np.full((bottom - top + 2 * _REACH, width + 2 * _REACH), _NAN)
    for a in range(max(top - _REACH, 0), min(bottom + _REACH, height)):
        row = depth[a - top + _REACH, _REACH : _REACH + width]
        if stride == 1:
            _copy_depth(xyz[a], row)
        else:
            for j in range(width):
                row[j] = xyz[stride * a, stride * j, 2]
    rows, sparse, on_step = np.empty((2, width), np.float32), np.empty(width, np.float32), np.empty(width, np.uint8)
    for a in range(top, bottom):
        k, out = a - top + _REACH, bends[a + SPREAD, SPREAD : SPREAD + width]
        steps_of_row(depth, k, _REACH, least[0], least[1], half_order, on_step)
        link_row(depth, k, _REACH, most[0], most[1], on_step, known[a], link[a])
        if stride == 1:
            _bends_of_row(depth, k, near, half_order, sigma[a], rows, out)
        else:
            for j in range(width):
                sparse[j] = sigma[stride * a, stride * j]
            _bends_of_row(depth, k, near, half_order, sparse, rows, out)


@linked
def _add_clear(most: Any, own: Any, sigma: Any) -> None:
    """Add ``most`` (W,), where it is clear, else ``own`` (W,) to the variance of a row."""
    for j in range(own.shape[0]):
        square = sigma[j] * sigma[j]
        sigma[j] = np.float32(sqrt(square + (most[j] if most[j] > CLEAR * square else own[j])))


@parallel_allocating
def _widen(block: int, stride: int, bends: Any, sigma: Any) -> None:
    """Add the bends, or the largest clear one within :data:`SPREAD` pixels, to the variance of :data:`ROWS` rows."""
    height, width = bends.shape[0] - 2 * SPREAD, bends.shape[1] - 2 * SPREAD
    most, reach = np.empty(width, np.float32), max(SPREAD // stride, 1)
    for a in range(block * ROWS, min(block * ROWS + ROWS, height)):
        most[:] = _ZERO
        for step in range(SPREAD - reach, SPREAD + reach + 1):
            across, along = bends[a + step, SPREAD : SPREAD + width], bends[a + SPREAD, step : step + width]
            for j in range(width):
                here = across[j] if across[j] > along[j] else along[j]
                most[j] = here if here > most[j] else most[j]
        own = bends[a + SPREAD, SPREAD : SPREAD + width]
        if stride == 1:
            _add_clear(most, own, sigma[a])
        else:
            _add_clear(most, own, sigma[stride * a, ::stride])


def bends_of(shape: tuple[int, int]) -> F32:
    """Array for :func:`widen_at_bends`; ``shape`` of the measured pixels."""
    return np.zeros((shape[0] + 2 * SPREAD, shape[1] + 2 * SPREAD), np.float32)


def widen_at_bends(
    stride: int, per_order: np.float32, steps: DepthSteps, xyz: F32, sigma: F32, bends: F32,
    known: NDArray[np.uint8], link: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Raise the standard deviation of points at sharp bends, and find the points not on blurred steps and their links.

    Args:
        stride: of the measured pixels; per_order: change of 1 / z from one fringe order to the next, 1 / mm.
        xyz: (H, W, 3), sigma: (H, W), mm, NaN where unknown; the second is changed.
        bends: of :func:`bends_of`, written but for its border.
        known, link: (h, w) of the measured pixels, written, of :func:`pipeline.filter.depth_clusters.link_row`.
    """
    height = len(bends) - 2 * SPREAD
    _bends(blocks(height, ROWS), stride, per_order, *steps, xyz, sigma, bends, known, link)
    _widen(blocks(height, ROWS), stride, bends, sigma)
