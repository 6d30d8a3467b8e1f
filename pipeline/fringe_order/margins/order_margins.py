"""How clearly fringe orders win: what a surface would cost more with the second best orders.

A surface whose orders are all wrong by the same number is as smooth as the true one. Where its texture is uniform and
the projector's phase repeats (see :func:`pipeline.filter.point_filter.phase_weight`), it costs no more either, and the
search takes one of them by chance. Such orders are found by their margin: the mean cost of a surface's lattice pixels
with all orders changed alike, less that with their own. See :mod:`.sampled_groups` for the pixels that are compared.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import allocating, allocating_linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE

from pipeline.fringe_order.order_candidates import (  # isort: skip
    COST, COST_IMPOSSIBLE, INTEGER_SLOTS, SLOTS, candidate_costs, load_nodes,
)  # fmt: skip

LEAST_SHARE = 0.5
"""Share of a group's pixels that must have an order for it to compete."""
LARGEST_COST = 0.3
"""Mean cost up to which another order explains a group; saturated surfaces cost as much with their own as with any.
Where no other projector offset is possible, pixels that cost more with their own order, mostly those at a border, are
no evidence."""
UNEXPLAINED = 0.16
"""Least margin, where the fringes repeat, of groups that cost more than :data:`LARGEST_COST` with their own order, in
units of that cost: with phases as wrong as theirs all pixels count, and other orders compete whatever they cost."""
TEXTURE = 0.9
"""Share of the texture's weight in the margins: with all of it surfaces whose texture is that of the wrong place keep
their orders."""
CONTINUED = 0.45
"""Least mean margin against an order that continues what is beside a small surface, in units of the share of its border
that shows it."""
UNCONFIRMED = 0.1
"""Least mean margin of a small surface that nothing beside it confirms, see :attr:`Continued.unconfirmed`."""
LEAST_UNKNOWN, LEAST_OPEN = 0.3, 0.5
"""Shares of the places along such a surface's border at which it continues to pixels without an order, and to those or
to pixels of another one."""
EVEN = 0.002
"""Difference of costs up to which two orders explain a pixel alike, where the fringes repeat."""
AMBIGUOUS_SHARE = 0.35
"""Share of its pixels in ambiguous cells from which a large surface is rejected; its other cells decide fewer."""
CLEAR_GAIN, CLEAR_SHARE = 0.03, 0.5
"""The same where pixels agree with the projector's offset up to noise and the fringes do not repeat: gain in log
likelihood from which they do, see :class:`pipeline.reconstruct.column_correction.OffsetLikelihood`."""
VAGUE_GAIN, VAGUE_SHARE = 0.1, 0.25
"""The same where few do, and another offset explains the pair as well: all of a wall may have wrong orders."""
MOST_REJECTED = 0.25
"""Share of the pixels of all surfaces that may be rejected where the fringes repeat. Where more are, orders that win
clearly are wrong as well, and groups with which any other order competes get no points."""


class Continued(NamedTuple):
    """Orders by which surfaces would continue what is beside them, (n,) each.

    Args:
        change: of the order, int32, 0 = none; share: float32, of the places along the border that show it.
        jumps, unknown: float32, share of the places where phase and brightness continue, but with any other order, and
            where they continue to pixels without an order.
    """

    change: NDArray[np.int32]
    share: NDArray[np.float32]
    jumps: NDArray[np.float32]
    unknown: NDArray[np.float32]

    @staticmethod
    def none(surfaces: int) -> Continued:
        """Of so many surfaces that continue nothing, in arrays of their own."""
        return Continued(np.zeros(surfaces, np.int32), *(np.zeros(surfaces, np.float32) for _ in range(3)))

    @property
    def open(self) -> NDArray[np.float32]:
        """Share of the places where phase and brightness continue, but with another order or none, (n,)."""
        return self.jumps + self.unknown

    @property
    def unconfirmed(self) -> NDArray[np.bool_]:
        """Whether most of what a surface continues to has another order or none, (n,)."""
        return (self.unknown >= LEAST_UNKNOWN) & (self.open >= LEAST_OPEN)


class Limits(NamedTuple):
    """When orders win clearly.

    Args:
        margin: the least one, 0 = no test; shifts: (n,) changes of the column correction that other orders may have.
        even: difference of costs up to which two orders explain a pixel alike; surfaces have no margin where the same
            other order does so at more than half of their pixels. Negative: no such test.
        gain: in log likelihood per pixel, of the column correction.
    """

    margin: float
    shifts: NDArray[np.float64]
    even: float = -1.0
    gain: float = 0.0

    @property
    def largest_own(self) -> float:
        """Cost of a pixel's own order up to which the pixel counts."""
        return np.inf if len(self.shifts) else LARGEST_COST

    @property
    def ambiguous_share(self) -> float:
        """Share of its pixels in ambiguous cells from which a large surface is rejected."""
        if len(self.shifts) and self.gain < VAGUE_GAIN:
            return VAGUE_SHARE
        return CLEAR_SHARE if self.gain >= CLEAR_GAIN and self.even < 0 else AMBIGUOUS_SHARE

    @property
    def most_rejected(self) -> float:
        """As :data:`MOST_REJECTED`; 1 where the fringes do not repeat."""
        return MOST_REJECTED if self.even >= 0 else 1.0


@parallel_allocating
def costs_of_nodes(
    block: int, nodes: Any, pixels: Any, rays: Any, phase: Any, descriptors: Any, other_descriptors: Any, columns: Any,
    linear: bool, correction: Any, extent: Any, labels: int, axis: int, inv: Any, texture: Any, first: Any, count: Any,
    costs: Any,
) -> None:  # fmt: skip
    """Costs of all candidates of a block of TILE lattice pixels; arguments as of the search's ``search_rows``.

    Args:
        nodes, pixels: (n,) numbers of the lattice pixels in the lattice and in the image.
        first, count: (h w,) int32, written at these; costs: (n, labels) float32, written.
    """
    height, width = other_descriptors.shape
    t, k = np.zeros(SLOTS * TILE, np.float32), np.zeros(INTEGER_SLOTS * TILE, np.int32)
    start = block * TILE
    n = min(TILE, nodes.shape[0] - start)
    part = nodes[start : start + n]
    most = load_nodes(t, k, part, pixels[start : start + n], n, rays.reshape(-1), phase.reshape(-1),
                      descriptors.reshape(-1), first, count, labels)  # fmt: skip
    other = other_descriptors.reshape(-1)
    costs[start : start + n] = COST_IMPOSSIBLE
    for order in range(most):
        candidate_costs(t, k, order, columns, linear, correction, extent, other, width, height, axis, inv, texture)
        for j in range(n):
            if order < count[part[j]]:
                costs[start + j, order] = t[COST + j]


@allocating
def least_margins(
    group: Any, own: Any, first: Any, count: Any, costs: Any, least_share: Any, largest_cost: Any, largest_own: Any,
    even: Any, unexplained: Any, continued: Any, share: Any, unconfirmed: Any, out: Any,
) -> None:  # fmt: skip
    """Least margin of each group plus its standard error, (groups,) float32; infinite where no other order competes.

    Args:
        group: (n,) of the sampled pixels; own: their orders, int16; first, count: (n,) of their candidates.
        costs: (n, labels).
        least_share: of a group's pixels that must have an order for it to compete.
        largest_cost: its largest mean cost; largest_own: as :attr:`Limits.largest_own`.
        even: as of :class:`Limits`; unexplained: as :data:`UNEXPLAINED`, where ``even`` is not negative.
        continued, share, unconfirmed: (surfaces,) of the first groups, see :class:`Continued`.
    """
    labels = costs.shape[1]
    total, squares = np.zeros((out.shape[0], 2 * labels)), np.zeros((out.shape[0], 2 * labels))
    level = np.zeros((out.shape[0], 2 * labels))
    pixels, alike = np.zeros((out.shape[0], 2 * labels), np.int32), np.zeros((out.shape[0], 2 * labels), np.int32)
    own_cost = np.zeros(out.shape[0])
    if even >= 0:
        own_cost = _mean_own(group, own, first, count, costs, out.shape[0])
    for m in range(group.shape[0]):
        k, here = group[m], own[m] - first[m]
        if here < 0 or here >= count[m] or (costs[m, here] > largest_own and own_cost[k] <= largest_cost):
            continue
        for order in range(count[m]):
            change = order - here + labels
            more = np.float64(costs[m, order] - costs[m, here])
            total[k, change] += more
            squares[k, change] += more * more
            level[k, change] += costs[m, order]
            pixels[k, change] += 1
            alike[k, change] += more <= even and even >= 0
    for k in range(out.shape[0]):
        out[k] = np.inf
        for change in range(2 * labels):
            n = pixels[k, change]
            if change == labels or n < 2 or n < least_share * pixels[k, labels]:
                continue
            if 2 * alike[k, change] > n:
                out[k] = min(out[k], np.float32(0.0))
            mean = total[k, change] / n
            error = np.sqrt(max(squares[k, change] / n - mean * mean, 0.0) / (n - 1))
            if k < continued.shape[0] and change == labels + continued[k] and mean < CONTINUED * share[k]:
                out[k] = min(out[k], np.float32(0.0))
            if own_cost[k] > largest_cost and mean + error < unexplained * own_cost[k]:
                out[k] = min(out[k], np.float32(0.0))
            if level[k, change] <= largest_cost * n:
                out[k] = min(out[k], np.float32(mean + error))
                if k < continued.shape[0] and unconfirmed[k] and mean < UNCONFIRMED:
                    out[k] = min(out[k], np.float32(0.0))


@allocating_linked
def _mean_own(group: Any, own: Any, first: Any, count: Any, costs: Any, groups: int) -> Any:
    """Mean cost of each group's pixels with their own orders, (groups,); arguments as of :func:`least_margins`."""
    total, pixels = np.zeros(groups), np.zeros(groups, np.int32)
    for m in range(group.shape[0]):
        here = own[m] - first[m]
        if 0 <= here < count[m]:
            total[group[m]] += costs[m, here]
            pixels[group[m]] += 1
    return total / np.maximum(pixels, 1)
