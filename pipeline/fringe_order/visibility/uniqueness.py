"""Uniqueness in the other image: of orders that lead to one place there, those of the surface that agrees best.

Where the fringes repeat (see :func:`pipeline.filter.point_filter.phase_weight`), a strip that only this camera sees
takes an order that leads to another surface in the other image, and the search from there may confirm it, because it
finds this strip as good as the surface's own pixels. The costs of both distinguish them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE

from pipeline.fringe_order.order_candidates import (  # isort: skip
    CELL, COST, FRACTION, INTEGER_SLOTS, PHI, SLOTS, VISIBLE, candidate_costs, load_nodes,
)  # fmt: skip
from pipeline.fringe_order.semi_global_aggregation import NONE

ROWS = 8
"""Lattice rows that share scratch arrays."""
_TURN = np.float32(2 * np.pi)
_ZERO, _ONE = np.float32(0), np.float32(1)


class Claims(NamedTuple):
    """Where orders lead in the other image, (h, w) each, see :func:`claims`."""

    place: NDArray[np.int32]
    value: NDArray[np.float32]
    cost: NDArray[np.float32]


@parallel_allocating
def claims(
    block: int, order: Any, top: int, down: int, left: int, step: int, rays: Any, phase: Any, descriptors: Any,
    other_descriptors: Any, columns: Any, linear: bool, correction: Any, extent: Any, labels: int, axis: int, inv: Any,
    texture: Any, other_top: int, other_down: int, other_left: int, other_step: int, other_shape: Any, slope_x: Any,
    slope_y: Any, place: Any, value: Any, cost: Any,
) -> None:  # fmt: skip
    """Where in the other image the orders of :data:`ROWS` lattice rows lead, and what they cost.

    Args:
        order: (h, w) int16, NONE = none; other arguments up to ``texture``: as of the search's ``search_rows``.
        other_top .. other_step, other_shape: position and shape of the other image's lattice.
        slope_x, slope_y: the other image's expected phase steps per pixel.
        place: (h, w) int32, number of the other lattice's nearest pixel, -1 = none; value: (h, w) float32, absolute
            phase less the expected slope there; cost: (h, w) float32. The last two are written where there is a place.
    """
    height, width = other_descriptors.shape
    w, pixels_across = order.shape[1], descriptors.shape[1]
    per_row, per_column = _ONE / np.float32(other_down), _ONE / np.float32(other_step)
    flat_phase, flat_descriptors, flat_other = phase.reshape(-1), descriptors.reshape(-1), other_descriptors.reshape(-1)
    t, k = np.zeros(SLOTS * TILE, np.float32), np.zeros(INTEGER_SLOTS * TILE, np.int32)
    first, count = np.empty(w, np.int32), np.empty(w, np.int32)
    nodes, pixels = np.empty(w, np.int32), np.empty(w, np.int32)
    only = np.int64(0)  # a constant would be a type of its own, and the costs compiled once more
    for a in range(block * ROWS, min((block + 1) * ROWS, order.shape[0])):
        row_rays = rays[a].reshape(-1)
        n = 0
        for b in range(w):
            place[a, b] = -1
            if order[a, b] != NONE:
                nodes[n], pixels[n] = b, (top + down * a) * pixels_across + left + step * b
                n += 1
        for o in range(0, n, TILE):
            m = min(TILE, n - o)
            part = nodes[o : o + m]
            load_nodes(t, k, part, pixels[o : o + m], m, row_rays, flat_phase, flat_descriptors, first, count, labels)
            for j in range(m):
                t[PHI + j] = flat_phase[pixels[o + j]] + _TURN * np.float32(order[a, part[j]])
            candidate_costs(
                t, k, only, columns, linear, correction, extent, flat_other, width, height, axis, inv, texture
            )
            for j in range(m):
                row = k[CELL + j] // np.int32(width)
                column = k[CELL + j] - row * np.int32(width)
                y, x = np.float32(row), np.float32(column)
                y, x = (y, x + t[FRACTION + j]) if axis == 0 else (y + t[FRACTION + j], x)
                p = np.int32(np.rint((y - np.float32(other_top)) * per_row))
                q = np.int32(np.rint((x - np.float32(other_left)) * per_column))
                inside = (p >= 0) & (q >= 0) & (p < other_shape[0]) & (q < other_shape[1])
                if inside and t[VISIBLE + j] > _ZERO:
                    b = part[j]
                    place[a, b] = p * other_shape[1] + q
                    value[a, b] = t[PHI + j] - slope_x * x - slope_y * y
                    cost[a, b] = t[COST + j]


@serial
def reject_contradicted(place: Any, value: Any, cost: Any, limit: Any, least: Any, order: Any) -> None:
    """Change orders to NONE where one of another surface costs less at the same place of the other image.

    Args:
        place, value, cost: (n,) of :func:`claims`; order: (n,) int16, some of those claims' orders, changed.
        limit: difference of the values from which they are of another surface.
        least: (places,) int32, scratch.
    """
    least[:] = -1
    for b in range(place.shape[0]):
        c = place[b]
        if c >= 0 and (least[c] < 0 or cost[b] < cost[least[c]]):
            least[c] = b
    for b in range(place.shape[0]):
        if place[b] >= 0:
            best = least[place[b]]
            if cost[b] > cost[best] and abs(value[b] - value[best]) >= limit:
                order[b] = NONE
