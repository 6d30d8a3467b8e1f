"""Sub-pixel match along the epipolar curve, and the point.

For a left pixel with a known order the right camera must see the same pointwise phase at the image of the point. The
unknown is one number, the inverse depth w = 1/z on the pixel's viewing ray; some Newton steps on the phases, from where
the projector's column lies, find it. Because the match is sought along the ray's own epipolar curve, by both full
camera models, the four linear equations of the two views (see :mod:`pipeline.geometry.triangulate`) agree there: the
point on the ray is their solution.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE
from pipeline.match.epipolar_search import OK
from pipeline.match.tile_match import load, match_tile, scratch, store_phases, store_places, store_points

ROWS = 8
"""Rows that share their scratch arrays."""
_ZERO, _ONE = np.float32(0), np.float32(1)


@parallel_allocating
def refine(
    block: int, order: Any, rays_x: Any, rays_y: Any, phase: Any, descriptors: Any, phasor: Any, variance: Any,
    other: Any, other_variance: Any, model: Any, stride: int, xyz: Any, sigma: Any, valid: Any, right_u: Any,
    right_v: Any, projector_u: Any, projector_v: Any, absolute_phase: Any, residual_normalised: Any, residual: Any,
) -> None:  # fmt: skip
    """Match and locate every pixel that has an order, in a block of :data:`ROWS` rows; float32 unless stated.

    Args:
        order: (H, W) int16; rays_x, rays_y: (H, W) ideal normalised points of the pixels.
        descriptors: (H, W) int32, see :mod:`pipeline.decode.pixel_descriptor`; phasor, other: (H, W) int32, packed.
        model: :class:`pipeline.match.tile_match.MatchModel`.
        xyz, sigma: (every H, every W, 3) and (every H, every W) or a little less, mm; pixel (i, j) is theirs at (every
            i, every j). Written where valid; elsewhere perhaps.
        valid ... residual: the planes of :class:`pipeline.match.match_result.MatchResult`, written.
    """
    height, width = order.shape
    tiles = (width + TILE - 1) // TILE
    arrays = scratch()
    flat, flat_variance = other.reshape(-1), other_variance.reshape(-1)
    t = arrays[0]
    for number in range(ROWS * tiles):
        i, tile = block * ROWS + number // tiles, number % tiles
        if i >= height:
            break
        j0 = tile * TILE
        n = min(TILE, width - j0)
        found = 0
        row = order[i, j0 : j0 + n]
        for j in range(n):
            active = row[j] != -32768
            found += active
            t[OK + j] = _ONE if active else _ZERO
        end = j0 + n
        if found == 0:
            valid[i, j0:end] = 0
            continue
        load(t, n, row, phase[i, j0:end], descriptors[i, j0:end], phasor[i, j0:end], rays_x[i, j0:end],
             rays_y[i, j0:end])  # fmt: skip
        match_tile(arrays, n, model, flat, flat_variance)
        store_phases(t, n, absolute_phase[i, j0:end], residual_normalised[i, j0:end], residual[i, j0:end])
        store_places(t, n, right_u[i, j0:end], right_v[i, j0:end], projector_u[i, j0:end], projector_v[i, j0:end])
        store_points(t, n, variance[i, j0:end], j0, stride, xyz[stride * i], sigma[stride * i], valid[i, j0:end])
