"""Pixels that agree badly or not at all are matched again with the fringe orders of surfaces beside them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import allocating_linked, linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.filter.texture_agreement import DEVIATION_STEPS, deviations_of_row, right_values_of_row
from pipeline.match.epipolar_search import OK
from pipeline.match.match_result import RESIDUAL_STEP
from pipeline.match.neighbour_orders import NONE, classify_row, propose_row
from pipeline.match.tile_match import load, match_tile, scratch, store_phases, store_places, store_points

ROWS = 8
"""Rows that share their scratch arrays."""
GOOD = 3 * DEVIATION_STEPS // 2
"""Deviation of the texture up to which a pixel's order is continued to its neighbours."""
BAD = 3 * DEVIATION_STEPS
"""Deviation of the texture from which another order is tried."""
GAIN = DEVIATION_STEPS
"""How much less a pixel must deviate with another order."""
REACH = 8
"""Distance in pixels over which orders are continued."""
LARGEST_STEP = np.float32(1.5)
"""Largest deviation from the continued phase, radians."""
LARGEST_RESIDUAL = int(0.5 / RESIDUAL_STEP)
"""Largest deviation of a continued pixel from the projector's phase, steps."""
_ONE = np.float32(1)


class LeftImage(NamedTuple):
    """Planes of the left camera that a match reads, as of :func:`pipeline.match.subpixel_match.refine`.

    Args:
        mean, amplitude: (H, W) uint8, counts; valid: (H, W) bool.
    """

    rays_x: Any
    rays_y: Any
    phase: Any
    descriptors: Any
    phasor: Any
    variance: Any
    mean: Any
    amplitude: Any
    valid: Any


class RightImage(NamedTuple):
    """Planes of the right camera's image that a match reads, flat."""

    phasor: Any
    variance: Any
    mean: Any
    amplitude: Any


class _Tile(NamedTuple):
    """What one tile of gathered pixels reads (up to ``amplitude``) and gives."""

    order: Any
    phase: Any
    descriptors: Any
    phasor: Any
    rays_x: Any
    rays_y: Any
    variance: Any
    mean: Any
    amplitude: Any
    xyz: Any
    sigma: Any
    valid: Any
    places: Any
    phases: Any
    deviation: Any
    misfit: Any
    right: Any
    place: Any
    values: Any


@allocating_linked
def _empty_tile() -> Any:
    f, i = np.float32, np.int32
    return _Tile(
        np.empty(TILE, np.int16), np.empty(TILE, f), np.empty(TILE, i), np.empty(TILE, i), np.empty(TILE, f),
        np.empty(TILE, f), np.empty(TILE, f), np.empty(TILE, np.uint8), np.empty(TILE, np.uint8),
        np.empty((TILE, 3), f), np.empty(TILE, f), np.empty(TILE, np.uint8), np.empty((4, TILE), np.uint16),
        np.empty((3, TILE), np.int16), np.empty(TILE, np.uint8), np.empty(TILE, np.uint8), np.empty((2, TILE), f),
        np.empty(TILE, i), np.empty((4, TILE), np.uint8),
    )  # fmt: skip


@linked
def _match_gathered(pixels: Any, left: Any, right: Any, model: Any, scales: Any, arrays: Any, tile: Any) -> None:
    """Match up to TILE pixels (rows and columns) with the orders in ``tile.order``; the tile keeps the results."""
    n = pixels.shape[0]
    for m in range(n):
        i, j = pixels[m, 0], pixels[m, 1]
        tile.phase[m], tile.descriptors[m], tile.phasor[m] = left.phase[i, j], left.descriptors[i, j], left.phasor[i, j]
        tile.rays_x[m], tile.rays_y[m] = left.rays_x[i, j], left.rays_y[i, j]
        tile.variance[m] = left.variance[i, j]
        tile.mean[m], tile.amplitude[m] = left.mean[i, j], left.amplitude[i, j]
    t = arrays[0]
    t[OK : OK + n] = _ONE
    load(t, n, tile.order, tile.phase, tile.descriptors, tile.phasor, tile.rays_x, tile.rays_y)
    match_tile(arrays, n, model, right.phasor, right.variance)
    store_phases(t, n, tile.phases[0], tile.phases[1], tile.phases[2])
    store_places(t, n, tile.places[0], tile.places[1], tile.places[2], tile.places[3])
    store_points(t, n, tile.variance, np.int64(0), np.int64(1), tile.xyz, tile.sigma, tile.valid)
    right_values_of_row(
        tile.valid[:n], tile.places[0], tile.places[1], right.mean, right.amplitude, model.width, tile.place,
        tile.values, tile.right,
    )  # fmt: skip
    deviations_of_row(
        tile.valid[:n], tile.mean, tile.amplitude, tile.right, scales, tile.deviation, tile.misfit
    )  # fmt: skip


@parallel_allocating
def match_neighbours(
    block: int, order: Any, left: Any, right: Any, model: Any, scales: Any, slope: Any, stride: int, xyz: Any,
    sigma: Any, valid: Any, right_u: Any, right_v: Any, projector_u: Any, projector_v: Any, absolute_phase: Any,
    residual_normalised: Any, residual: Any, deviation: Any, misfit: Any,
) -> None:  # fmt: skip
    """Try the orders of neighbouring surfaces in a block of :data:`ROWS` rows, and keep what agrees better.

    Args:
        order: (H, W) int16, changed; left: :class:`LeftImage`; right: :class:`RightImage`.
        model: :class:`pipeline.match.tile_match.MatchModel`.
        scales: of :func:`pipeline.filter.texture_agreement.scales_of`; slope: expected phase step per pixel, radians.
        xyz, sigma: the points' planes, pixel (i, j) is theirs at (stride i, stride j); changed, as is all that follows.
        valid ... residual: the planes of :class:`pipeline.match.match_result.MatchResult`.
        deviation, misfit: of :class:`pipeline.filter.texture_agreement.Agreement`.
    """
    height, width = order.shape
    arrays, tile = scratch(), _empty_tile()
    top, bottom = block * ROWS, min((block + 1) * ROWS, height)
    state = np.zeros(8 * ((width + 7) // 8), np.uint8)
    ahead, columns = np.empty(width, np.int16), np.empty(width, np.int32)
    pixels, orders = np.empty((2, ROWS * width, 2), np.int32), np.empty((2, ROWS * width), np.int16)
    found = np.zeros(2, np.int64)
    for i in range(top, bottom):
        classify_row(deviation[i], left.valid[i], GOOD, BAD, state)
        ahead[:] = NONE
        for side in range(2):
            first = found[side]
            n = propose_row(
                side, state, order[i], left.phase[i], slope, REACH, LARGEST_STEP, ahead, columns, orders[side, first:]
            )
            for m in range(n):
                pixels[side, first + m, 0], pixels[side, first + m, 1] = i, columns[m]
            found[side] += n
    for side in range(2):
        for start in range(0, found[side], TILE):
            some = pixels[side, start : min(start + TILE, found[side])]
            for m in range(some.shape[0]):  # numba would compile a message for slices of different lengths: 3 s
                tile.order[m] = orders[side, start + m]
            _match_gathered(some, left, right, model, scales, arrays, tile)
            for m in range(some.shape[0]):
                i, j, new = some[m, 0], some[m, 1], np.int32(tile.deviation[m])
                first, second = np.int32(tile.phases[1, m]), np.int32(tile.phases[2, m])
                if new >= BAD or new + GAIN >= np.int32(deviation[i, j]):
                    continue
                if min(abs(first), abs(second)) >= LARGEST_RESIDUAL:
                    continue
                order[i, j], deviation[i, j], misfit[i, j] = tile.order[m], tile.deviation[m], tile.misfit[m]
                valid[i, j] = tile.valid[m]
                right_u[i, j], right_v[i, j] = tile.places[0, m], tile.places[1, m]
                projector_u[i, j], projector_v[i, j] = tile.places[2, m], tile.places[3, m]
                absolute_phase[i, j] = tile.phases[0, m]
                residual_normalised[i, j], residual[i, j] = tile.phases[1, m], tile.phases[2, m]
                a, b = stride * i, stride * j
                for c in range(3):
                    xyz[a, b, c] = tile.xyz[m, c]
                sigma[a, b] = tile.sigma[m]
