"""The order search in strips of lattice rows: candidates, their costs, and the horizontal paths, while in cache."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.parallel_for import parallel, parallel_allocating
from pipeline.common.tile_math import TILE

from pipeline.fringe_order.order_candidates import (  # isort: skip
    COST, COST_IMPOSSIBLE, INTEGER_SLOTS, MOVE, SLOTS, apply_prior, candidate_costs, load_nodes,
)  # fmt: skip
from pipeline.fringe_order.phase_links import row_links
from pipeline.fringe_order.semi_global_aggregation import NONE, along_row

REFRESH = 16
"""Every lattice row is searched without the prior once in this many pairs, so that no error lasts longer."""
STRIP = 4
"""Lattice rows that are searched together."""
_CELL = 16
"""Columns of a strip that are searched together once enough of them contradict the prior."""
_FEW = 8
"""One contradiction among this many expected orders is enough."""
_TURN, _NAN, _ZERO = np.float32(2 * np.pi), np.float32(np.nan), np.float32(0)


@parallel_allocating
def search_rows(
    strip: int, top: int, down: int, left: int, step: int, stride: int, rays: Any,
    phase: Any, descriptors: Any, valid: Any, brightness: Any, contrast: Any, other_descriptors: Any,
    columns: Any, linear: bool, correction: Any, extent: Any, labels: int, axis: int, slope: Any,
    inv: Any, texture: Any, penalty: Any, certain: Any, expected: Any, refresh: int, limit: Any,
    costs: Any, total: Any, first: Any, count: Any, place: Any,
) -> None:  # fmt: skip
    """Compute the candidates' costs on the lattice (on every n-th row) and aggregate along its rows.

    Args:
        top, down, left, step: lattice pixel (a, b) is row ``top + down a``, column ``left + step b``.
        rays: (h, w, RAY), see :data:`pipeline.fringe_order.order_candidates.RAY`.
        phase: (H, W) float32; valid: (H, W) bool.
        brightness: (H, W) uint8; contrast: factor of its squared contrasts, see :mod:`.phase_links`.
        descriptors, other_descriptors: (H, W) int32, of both images, see :mod:`pipeline.decode.pixel_descriptor`.
        columns: even-grid table phase -> projector coordinate; linear: it is a straight line; extent: projector pixels
            across.
        labels: most orders of a pixel; axis: 0 = phase grows along u; slope: expected phase step per pixel of the row.
        inv: 1 / (2 cost_sigma^2).
        certain: (h, w) int16, orders that need no search, NONE = open.
        expected: (h, w) float32, expected absolute phase (the prior), NaN = unknown; a pixel whose expected order
            costs at most ``limit``, amid others for which that holds, has no other candidate. Not used in lattice
            rows a with ``a % REFRESH == refresh``; refresh < 0: nowhere.
        costs, total: (h * w * labels,) float32, written where there are several candidates; first, count: (h, w) int32,
            written.
        place: (h, w) int32, where the costs of a pixel's orders begin, written where orders are searched. Those of a
            strip lie together, since few pixels of a lattice are.
    """
    h, w = expected.shape
    height, width = other_descriptors.shape
    pixels_across = descriptors.shape[1]
    flat_rays = rays.reshape(-1)
    flat_expected, flat_first, flat_count = expected.reshape(-1), first.reshape(-1), count.reshape(-1)
    flat_phase, flat_descriptors, flat_place = phase.reshape(-1), descriptors.reshape(-1), place.reshape(-1)
    flat_other = other_descriptors.reshape(-1)
    a0, a1 = strip * STRIP, min(strip * STRIP + STRIP, h)
    t, k = np.zeros(SLOTS * TILE, np.float32), np.zeros(INTEGER_SLOTS * TILE, np.int32)
    # 0: to be searched, 1: left out, 2: as expected, 3: contradicts the prior, or is not yet compared with it.
    state = np.zeros((STRIP, w), np.int8)
    nodes, pixels = np.empty(STRIP * w, np.int32), np.empty(STRIP * w, np.int32)
    n, free = 0, a0 * w * labels
    for a in range(a0, a1):
        use_prior = refresh >= 0 and a % REFRESH != refresh
        row_state = state[a - a0]
        for b in range(w):
            pixel = (top + down * a, left + step * b)
            flat_first[a * w + b], flat_count[a * w + b] = 0, 0
            if a % stride or not valid[pixel]:
                row_state[b] = 1
            elif certain[a, b] != NONE:
                row_state[b] = 1
                flat_first[a * w + b], flat_count[a * w + b] = certain[a, b], 1
            else:
                place[a, b], free = free, free + labels
            if row_state[b] == 0 and use_prior and expected[a, b] == expected[a, b]:
                row_state[b] = 3
                nodes[n], pixels[n] = a * w + b, pixel[0] * pixels_across + pixel[1]
                n += 1
    for o in range(0, n, TILE):
        m = min(TILE, n - o)
        part = nodes[o : o + m]
        load_nodes(t, k, part, pixels[o : o + m], m, flat_rays, flat_phase, flat_descriptors,
                   flat_first, flat_count, labels)  # fmt: skip
        apply_prior(t, part, m, flat_expected)
        candidate_costs(
            t, k, np.int64(0), columns, linear, correction, extent, flat_other, width, height, axis, inv, texture
        )
        for j in range(m):
            node = np.uint32(part[j])
            if t[COST + j] <= limit and t[MOVE + j] >= _ZERO:
                state[part[j] // w - a0, part[j] % w] = 2
                flat_first[node] += np.int32(t[MOVE + j])
                flat_count[node] = 1
                costs[np.uint32(flat_place[node])] = t[COST + j]
    n = 0
    for b0 in range(0, w, _CELL):
        b1 = min(b0 + _CELL, w)
        agree, contradict = 0, 0
        for a in range(a1 - a0):
            for b in range(b0, b1):
                agree += state[a, b] == 2
                contradict += state[a, b] == 3
        doubtful = contradict * _FEW > agree + contradict
        for a in range(a1 - a0):
            for b in range(b0, b1):
                if state[a, b] != 1 and (state[a, b] != 2 or doubtful):
                    nodes[n] = (a0 + a) * w + b
                    pixels[n] = (top + down * (a0 + a)) * pixels_across + left + step * b
                    n += 1
    for o in range(0, n, TILE):
        m = min(TILE, n - o)
        part = nodes[o : o + m]
        most = load_nodes(t, k, part, pixels[o : o + m], m, flat_rays, flat_phase, flat_descriptors,
                          flat_first, flat_count, labels)  # fmt: skip
        for j in range(m):
            base = np.uint32(flat_place[np.uint32(part[j])])
            for order in range(np.uint32(labels)):
                costs[base + order] = COST_IMPOSSIBLE
        for order in range(most):
            candidate_costs(t, k, order, columns, linear, correction, extent, flat_other, width, height, axis, inv,
                            texture)  # fmt: skip
            for j in range(m):
                node = np.uint32(part[j])
                if order < flat_count[node]:
                    costs[np.uint32(flat_place[node]) + np.uint32(order)] = t[COST + j]
    jump, weight = np.empty(w, np.int32), np.empty(w, np.float32)
    paths = np.full(6 * labels, COST_IMPOSSIBLE)
    for a in range(a0, a1):
        i = top + down * a
        if a % stride == 0:
            row_links(phase[i], valid[i], brightness[i], contrast, left, step, slope, count[a], jump, weight)
            along_row(costs, place[a], first[a], count[a], jump, weight, penalty, labels, paths, total)


@parallel
def update_prior(
    a: int, order: Any, certain: Any, first: Any, count: Any, costs: Any, place: Any, limit: Any, top: int, down: int,
    left: int, step: int, phase: Any, expected: Any,
) -> None:  # fmt: skip
    """Absolute phases of lattice pixels whose order costs at most ``limit``, NaN elsewhere; see :func:`search_rows`.

    Args:
        order: (h, w) int16, NONE = unknown; certain: those that needed no search.
        first, count: of the candidates of the last search; orders beyond them cost too much.
        expected: (h, w) float32, written.
    """
    w = order.shape[1]
    i = top + down * a
    for b in range(w):
        value = _NAN
        label = order[a, b] - first[a, b]
        good = order[a, b] != NONE and 0 <= label < count[a, b]
        if good and certain[a, b] == NONE:
            good = costs[np.uint32(place[a, b] + label)] <= limit
        if good:
            value = phase[i, np.uint32(left + step * b)] + _TURN * np.float32(order[a, b])
        expected[a, b] = value
