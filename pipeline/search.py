"""The order search along one lattice row: candidates, their prices, and the horizontal paths, while they are in cache."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.aggregate import along_row, row_links
from pipeline.candidates import NO_SUCH, SLOTS, load_nodes, price
from pipeline.kernels import parallel, prange
from pipeline.tiles import TILE

_COST = (SLOTS - 1) * TILE


@parallel
def search_rows(
    i0: int, down: int, j0: int, step: int, every: int, tables: Any, start: Any, stop: Any,
    phase: Any, phase_eq: Any, phasor: Any, equalized: Any, mean: Any, valid: Any,
    other_phasor: Any, other_equalized: Any, other_mean: Any,
    columns: Any, correction: Any, extent: Any, labels: int, lanes: int, axis: int, slope: Any,
    floor_sq: Any, inv: Any, texture: Any, penalty: Any, costs: Any, total: Any, first: Any, count: Any,
) -> None:  # fmt: skip
    """Price all candidates of the lattice (of every n-th row) and aggregate along its rows.

    Args:
        i0, down, j0, step: lattice pixel (a, b) is row ``i0 + down a``, column ``j0 + step b``.
        tables: (4, 3, h, w) along, across, other_u, other_v; start, stop: see :func:`candidates.order_limits`.
        phasor, equalized: (H, 2 W) float32 pairs; phase, phase_eq, mean: (H, W) float32; valid: (H, W) bool.
        other_phasor, other_equalized, other_mean: the other picture's.
        columns: even-grid table phase -> projector coordinate; extent: projector pixels across.
        labels: most orders of a pixel; lanes: the same, a multiple of :data:`aggregate.LANES`.
        axis: 0 = phase grows along u; slope: expected phase step per pixel along the row.
        inv: 1 / (2 cost_sigma^2).
        costs, total: (h, w * lanes) float32, written; first, count: (h, w) int32, written.
    """
    h, w = start.shape
    height, width = other_mean.shape
    flat_phasor, flat_equalized, flat_mean = other_phasor.reshape(-1), other_equalized.reshape(-1), other_mean.reshape(-1)
    for part in prange((h + every - 1) // every):
        a = part * every
        i = i0 + down * a
        t, k = np.zeros(SLOTS * TILE, np.float32), np.zeros(TILE, np.int32)
        row_costs, row_first, row_count = costs[a], first[a], count[a]
        row_costs[:] = NO_SUCH
        for b0 in range(0, w, TILE):
            n = min(TILE, w - b0)
            most = load_nodes(
                t, a, b0, n, i, j0, step, tables, start, stop, phase, phase_eq, phasor, equalized, mean, valid,
                row_first, row_count, labels,
            )  # fmt: skip
            for order in range(most):
                price(t, k, order, columns, correction, extent, flat_phasor, flat_equalized, flat_mean, width, height,
                      axis, floor_sq, inv, texture)  # fmt: skip
                for j in range(n):
                    if order < row_count[b0 + j]:
                        row_costs[np.uint32((b0 + j) * lanes + order)] = t[_COST + j]
        jump, trust = np.empty(w, np.int32), np.empty(w, np.float32)
        row_links(phase[i], valid[i], j0, step, slope, w, jump, trust)
        paths = np.full((2, 3 * lanes), NO_SUCH)
        along_row(row_costs, row_first, row_count, jump, trust, penalty, lanes, paths, total[a])
