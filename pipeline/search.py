"""The order search along one lattice row: candidates, their prices, and the horizontal paths, while they are in cache."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.aggregate import along_row, row_links
from pipeline.candidates import NO_SUCH, SLOTS, load_nodes, predict, price
from pipeline.kernels import parallel, prange
from pipeline.tiles import TILE

REFRESH = 16
"""Every lattice row is searched without expectations once in this many pairs, so that no error outlives them."""
_COST, _MOVE = (SLOTS - 1) * TILE, 7 * TILE


@parallel
def search_rows(
    top: int, down: int, left: int, step: int, every: int, tables: Any, start: Any, stop: Any,
    phase: Any, phase_eq: Any, phasor: Any, equalized: Any, mean: Any, valid: Any,
    other_phasor: Any, other_equalized: Any, other_mean: Any,
    columns: Any, correction: Any, extent: Any, labels: int, axis: int, slope: Any,
    floor_sq: Any, inv: Any, texture: Any, penalty: Any, expected: Any, turn: int, limit: Any,
    costs: Any, total: Any, first: Any, count: Any,
) -> None:  # fmt: skip
    """Price the candidates of the lattice (of every n-th row) and aggregate along its rows.

    Args:
        top, down, left, step: lattice pixel (a, b) is row ``top + down a``, column ``left + step b``.
        tables: (4, 3, h, w) along, across, other_u, other_v; start, stop: see :func:`candidates.order_limits`.
        phasor, equalized: (H, 2 W) float32 pairs; phase, phase_eq, mean: (H, W) float32; valid: (H, W) bool.
        other_phasor, other_equalized, other_mean: the other picture's.
        columns: even-grid table phase -> projector coordinate; extent: projector pixels across.
        labels: most orders of a pixel; axis: 0 = phase grows along u; slope: expected phase step per pixel of the row.
        inv: 1 / (2 cost_sigma^2).
        expected: (h, w) float32, absolute phase to be expected, NaN = unknown; a pixel whose expected order costs at
            most ``limit`` has no other candidate. Not used in lattice rows a with ``a % REFRESH == turn``; turn < 0:
            nowhere.
        costs, total: (h, w * labels) float32, written for the candidates there are; first, count: (h, w) int32, written.
    """
    h, w = start.shape
    height, width = other_mean.shape
    flat_phasor, flat_equalized, flat_mean = other_phasor.reshape(-1), other_equalized.reshape(-1), other_mean.reshape(-1)
    for part in prange((h + every - 1) // every):
        a = part * every
        i = top + down * a
        t, k = np.zeros(SLOTS * TILE, np.float32), np.zeros(TILE, np.int32)
        row_costs, row_first, row_count = costs[a], first[a], count[a]
        known, open_ = np.empty(w, np.int32), np.empty(w, np.int32)
        follow = turn >= 0 and a % REFRESH != turn
        n_known, n_open = 0, 0
        for b in range(w):
            row_first[b], row_count[b] = 0, 0
            if not valid[i, np.uint32(left + step * b)]:
                continue
            if follow and expected[a, b] == expected[a, b]:
                known[n_known] = b
                n_known += 1
            else:
                open_[n_open] = b
                n_open += 1
        for b0 in range(0, n_known, TILE):
            n = min(TILE, n_known - b0)
            nodes = known[b0 : b0 + n]
            load_nodes(t, nodes, n, a, i, left, step, tables, start, stop, phase, phase_eq, phasor, equalized, mean,
                       row_first, row_count, labels)  # fmt: skip
            predict(t, nodes, n, expected[a])
            price(t, k, 0, columns, correction, extent, flat_phasor, flat_equalized, flat_mean, width, height,
                  axis, floor_sq, inv, texture)  # fmt: skip
            for j in range(n):
                b = np.uint32(nodes[j])
                if t[_COST + j] <= limit and t[_MOVE + j] >= np.float32(0.0):
                    row_first[b] += np.int32(t[_MOVE + j])
                    row_count[b] = 1
                    row_costs[b * np.uint32(labels)] = t[_COST + j]
                else:
                    open_[n_open] = nodes[j]
                    n_open += 1
        for b0 in range(0, n_open, TILE):
            n = min(TILE, n_open - b0)
            nodes = open_[b0 : b0 + n]
            most = load_nodes(t, nodes, n, a, i, left, step, tables, start, stop, phase, phase_eq, phasor, equalized,
                              mean, row_first, row_count, labels)  # fmt: skip
            for order in range(most):
                price(t, k, order, columns, correction, extent, flat_phasor, flat_equalized, flat_mean, width, height,
                      axis, floor_sq, inv, texture)  # fmt: skip
                for j in range(n):
                    b = np.uint32(nodes[j])
                    if order < row_count[b]:
                        row_costs[b * np.uint32(labels) + np.uint32(order)] = t[_COST + j]
        jump, trust = np.empty(w, np.int32), np.empty(w, np.float32)
        row_links(phase[i], valid[i], left, step, slope, w, jump, trust)
        paths = np.full((2, 3 * labels), NO_SUCH)
        along_row(row_costs, row_first, row_count, jump, trust, penalty, labels, paths, total[a])
