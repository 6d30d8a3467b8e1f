"""What sharp bends of the depth add to the standard deviation of a point.

The phase of a pixel is fitted from a window. Where the window straddles two surfaces a few millimetres apart, or where
one of the cameras sees the end of a surface, the points between are wrong by up to the step, and neither the noise nor
the textures show it. The depth does: a point that lies off the straight line through its neighbours by more than their
noise explains has probably that error itself.

Two second differences along the rows and two along the columns: of the neighbours on both sides, and, within
:data:`FAR` pixels of the end of a surface, of the points farther inside. Noise alone gives a variance of 6 sigma^2.
Points whose depth differs by more than half a fringe order belong to another surface: a mixture of such phases does not
lie between both.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from pipeline.common.jit import inline, serial
from pipeline.common.parallel_for import parallel

ROWS = 32
"""Rows that are processed together."""
FAR = 3
"""Distance of the points farther inside, pixels; the second of them is twice as far."""
SHARE, NOISE = np.float32(0.5), np.float32(36.0)
"""Share of the squared difference that becomes variance, and how many variances of the point are taken as noise: six
times those of the difference, so that noise alone raises the standard deviation by 7 % at most."""
_REACH = 2 * FAR
_NAN, _ZERO, _TWO = np.float32(np.nan), np.float32(0.0), np.float32(2.0)


@inline
def _same(depth: Any, here: Any, most: Any) -> Any:
    """A neighbour's depth, NaN where it is unknown or of another surface."""
    return depth if abs(depth - here) <= most else _NAN


@inline
def _beyond(difference: Any, noise: Any) -> Any:
    """Square of a second difference beyond the noise, 0 where it is unknown."""
    square = difference * difference - noise
    return square if square > _ZERO else _ZERO


@serial
def _add_bends(z: Any, before: Any, after: Any, most: Any, noise: Any, more: Any) -> None:
    """Add the bends of a row to ``more`` (W,).

    Args:
        before, after: (W,) depth of the neighbours, NaN if unknown; most: (W,) largest step within a surface.
        noise: (W,) variance that is taken as noise.
    """
    for j in range(more.shape[0]):
        here, limit = z[j], most[j]
        more[j] += _beyond(_same(before[j], here, limit) - _TWO * here + _same(after[j], here, limit), noise[j])


@serial
def _add_ends(
    z: Any, before: Any, after: Any, farther: Any, beyond: Any, most: Any, noise: Any, more: Any
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
        more[j] += _beyond(_ZERO if both == both else inside, noise[j])


@serial
def _copy_depth(xyz: Any, out: Any) -> None:
    for j in range(out.shape[0]):
        out[j] = xyz[j, 2]


@serial
def _bends_of_row(depth: Any, k: int, half_order: Any, sigma: Any, rows: Any) -> None:
    """Raise ``sigma`` (W,) of row k of ``depth``, which has a border of unknown points; rows: (3, W), scratch."""
    end = _REACH + sigma.shape[0]
    row, z = depth[k], depth[k, _REACH:end]
    most, noise, more = rows[0], rows[1], rows[2]
    for j in range(sigma.shape[0]):
        most[j], noise[j], more[j] = half_order * z[j] * z[j], NOISE * sigma[j] * sigma[j], _ZERO
    _add_bends(z, row[_REACH - 1 : end - 1], row[_REACH + 1 : end + 1], most, noise, more)
    _add_bends(z, depth[k - 1, _REACH:end], depth[k + 1, _REACH:end], most, noise, more)
    _add_ends(z, row[_REACH - FAR : end - FAR], row[_REACH + FAR : end + FAR], row[: end - _REACH],
              row[2 * _REACH :], most, noise, more)  # fmt: skip
    _add_ends(z, depth[k - FAR, _REACH:end], depth[k + FAR, _REACH:end], depth[k - _REACH, _REACH:end],
              depth[k + _REACH, _REACH:end], most, noise, more)  # fmt: skip
    for j in range(sigma.shape[0]):
        sigma[j] = np.float32(sqrt(sigma[j] * sigma[j] + SHARE * more[j]))


@parallel
def widen_at_bends(block: int, stride: int, per_order: Any, xyz: Any, sigma: Any) -> None:
    """Raise the standard deviation of points at sharp bends, in a block of :data:`ROWS` rows of measured pixels.

    Args:
        stride: of the measured pixels; per_order: float32, change of 1 / z from one fringe order to the next, 1 / mm.
        xyz: (H, W, 3), sigma: (H, W), float32, mm, NaN where unknown; the second is changed.
    """
    height, width = len(range(0, sigma.shape[0], stride)), len(range(0, sigma.shape[1], stride))
    half_order = np.float32(0.5) * per_order
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
    rows, sparse = np.empty((3, width), np.float32), np.empty(width, np.float32)
    for a in range(top, bottom):
        k, row = a - top + _REACH, sigma[stride * a]
        if stride == 1:
            _bends_of_row(depth, k, half_order, row, rows)
        else:
            for j in range(width):
                sparse[j] = row[stride * j]
            _bends_of_row(depth, k, half_order, sparse, rows)
            for j in range(width):
                row[stride * j] = sparse[j]
