"""The fringe orders of one camera's lattice pixels, in arrays that every pair uses again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import blocks
from pipeline.common.tile_math import TILE
from pipeline.decode.decoder import PhaseMap
from pipeline.fringe_order import (
    order_candidates,
    order_margins,
    phase_links,
    semi_global_aggregation,
    strip_search,
    uniqueness,
)
from pipeline.fringe_order.coarse_to_fine import interpolate_orders
from pipeline.geometry.ray_tables import RayTable
from pipeline.geometry.view_tables import View

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

NO_PRIOR = -1
"""Search every row without the prior."""
CONFIDENT_LEAD = 2.5
"""Lead of the best order's total cost over the second best, in switch penalties, from which it is confident."""


class OrderSearch:
    """Order search of one view: on every second lattice pixel, then where that leaves pixels open."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._coarse, self._fine = _Lattice(view, view.table.every_second()), _Lattice(view, view.table)
        self._refresh, self._has_prior = 0, False

    def least_costs(self, reference: PhaseMap, other: PhaseMap, correction: F64, *, stride: int) -> NDArray[np.float32]:
        """(n,) least cost of each pixel with two candidates at least, on every n-th lattice row."""
        level = self._fine
        level.certain[:] = semi_global_aggregation.NONE
        level.search_rows(reference, other, correction, NO_PRIOR, stride)
        count = level.count[::stride]
        costs = level.costs[::stride].reshape(*count.shape, self._view.labels)
        exists = np.arange(self._view.labels) < count[..., None]
        return np.asarray(np.where(exists, costs, np.inf).min(axis=2)[count >= 2], dtype=np.float32)

    def search(self, reference: PhaseMap, other: PhaseMap, correction: F64, *, use_prior: bool) -> NDArray[np.int16]:
        """Orders (h, w) of the lattice pixels, valid until the next call.

        Args:
            reference, other: phases of this camera's image and of the other's.
            use_prior: search only where the orders of :meth:`set_prior` are contradicted, and a few rows in rotation.
        """
        coarse, fine, table, view = self._coarse, self._fine, self._view.table, self._view
        if use_prior and self._has_prior:
            # Testing one candidate of each pixel takes less than searching a quarter of them and unwrapping in between.
            self._refresh = (self._refresh + 1) % strip_search.REFRESH
            fine.certain[:] = semi_global_aggregation.NONE
            fine.search_rows(reference, other, correction, self._refresh, 1)
        else:
            coarse.search_rows(reference, other, correction, NO_PRIOR, 1)
            coarse.decide(reference)
            interpolate_orders(
                coarse.order, coarse.confident, reference.phase, reference.valid,
                table.top, table.down, table.left, table.step,
                np.float32(view.slopes[0]), np.float32(view.slopes[1]), fine.certain,
            )  # fmt: skip
            fine.search_rows(reference, other, correction, NO_PRIOR, 1)
        fine.decide(reference)
        return fine.order

    def reject_ambiguous(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, limits: order_margins.Limits,
        order: NDArray[np.int16], stride: int, label: NDArray[np.uint16], sizes: NDArray[np.int32],
        valid: NDArray[np.uint8],
    ) -> None:  # fmt: skip
        """Reject surfaces, large ones in cells, whose orders do not win clearly, see :mod:`.order_margins`.

        Args:
            order, label: (H / stride, W / stride) order, and one more than the surface, of every n-th pixel.
            sizes: pixels of each surface; valid: (H / stride, W / stride), changed.
        """
        if limits.margin > 0:
            groups = order_margins.Groups(label, sizes, order_margins.CELL // stride)
            margins = self._fine.margins(reference, other, correction, limits, order, stride, groups)
            groups.reject(margins < limits.margin, valid, entirely=limits.entirely)

    def reject_contradicted(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, other_view: View, order: NDArray[np.int16]
    ) -> None:
        """Change orders (h, w) to NONE where the last search's contradict them in the other image.

        See :mod:`.uniqueness`.
        """
        self._fine.reject_contradicted(reference, other, correction, other_view, order)

    def set_prior(self, reference: PhaseMap, order: NDArray[np.int16]) -> None:
        """Expect these orders (h, w) of the last search in the next one, where their cost was low."""
        fine, v, t = self._fine, self._view, self._view.table
        strip_search.update_prior(
            len(order), order, fine.certain, fine.first, fine.count, fine.costs, v.labels,
            np.float32(v.settings.follow_cost), t.top, t.down, t.left, t.step, reference.phase, fine.expected,
        )  # fmt: skip
        self._has_prior = True

    def clear_prior(self) -> None:
        """Expect nothing in the next search."""
        self._refresh, self._has_prior = 0, False


class _Lattice:
    """Candidates, costs and decisions of one lattice's pixels.

    Args:
        table: of the lattice's rays.
    """

    def __init__(self, view: View, table: RayTable) -> None:
        h, w = table.shape
        self._view, self.table = view, table
        self._rays = np.zeros((h, w, order_candidates.RAY), np.float32)
        self._rays[..., : len(table.lines)] = np.moveaxis(table.lines, 0, -1)
        # Only the elements of searched pixels are ever written.
        self.costs, self._total = (np.zeros((h, w * view.labels), np.float32) for _ in range(2))
        self.first, self.count = np.zeros((h, w), np.int32), np.zeros((h, w), np.int32)
        self._jump, self._weight = np.empty((h, w), np.int32), np.empty((h, w), np.float32)
        self._limited: tuple[F64, int] | None = None
        self.order, self.confident = np.empty((h, w), np.int16), np.empty((h, w), np.uint8)
        self.expected = np.full((h, w), np.nan, np.float32)
        self.certain = np.full((h, w), semi_global_aggregation.NONE, np.int16)

    def search_rows(self, reference: PhaseMap, other: PhaseMap, correction: F64, refresh: int, stride: int) -> None:
        """Compute the candidates' costs at the pixels that are not certain, and aggregate along the rows."""
        view, table, s = self._view, self.table, self._view.settings
        single = self._limit_orders(correction, stride)
        strip_search.search_rows(
            blocks(table.shape[0], strip_search.STRIP), table.top, table.down, table.left, table.step, stride,
            self._rays, reference.phase, reference.descriptors, reference.valid, other.descriptors,
            view.phase_to_column, view.linear, single, np.float32(view.extent), view.labels, view.first_axis,
            np.float32(view.slopes[0]), np.float32(0.5 / s.cost_sigma**2), np.float32(s.texture_weight),
            np.float32(s.switch_penalty), self.certain, self.expected, refresh, np.float32(s.follow_cost), self.costs,
            self._total, self.first, self.count,
        )  # fmt: skip

    def _limit_orders(self, correction: F64, stride: int) -> F32:
        """Bring the limits of every n-th row up to date with the correction, which is returned in single precision."""
        view, table, single = self._view, self.table, correction.astype(np.float32)
        known = self._limited is not None and np.array_equal(correction, self._limited[0])
        if self._limited is None or not known or stride % self._limited[1]:
            order_candidates.order_limits(
                blocks(len(self._rays), stride), stride, table.along, table.limits, view.column_to_phase, single,
                self._rays,
            )  # fmt: skip
            self._limited = correction.copy(), stride
        return single

    def margins(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, limits: order_margins.Limits,
        order: NDArray[np.int16], stride: int, groups: order_margins.Groups,
    ) -> NDArray[np.float32]:  # fmt: skip
        """(groups,) least margins of the orders; only lattice pixels in rows and columns of the stride count."""
        view, table, s = self._view, self.table, self._view.settings
        h, w = table.shape
        rows, columns = table.top + table.down * np.arange(h), table.left + table.step * np.arange(w)
        nodes, group = groups.sampled(*(np.where(x % stride == 0, x // stride, -1) for x in (rows, columns)))
        i, j = rows[nodes // w], columns[nodes % w]
        first, count = np.empty(h * w, np.int32), np.empty(h * w, np.int32)
        single = self._limit_orders(correction, 1)

        def costs_of(shift: float) -> F32:
            shifted, costs = single.copy(), np.empty((len(nodes), view.labels), np.float32)
            shifted[0] += shift
            order_margins.costs_of_nodes(
                blocks(len(nodes), TILE), nodes, i * reference.phase.shape[1] + j, self._rays, reference.phase,
                reference.descriptors, other.descriptors, view.phase_to_column, view.linear, shifted,
                np.float32(view.extent), view.labels, view.first_axis, np.float32(0.5 / s.cost_sigma**2),
                np.float32(s.texture_weight), first, count, costs,
            )  # fmt: skip
            return costs

        own, costs = order[i // stride, j // stride], costs_of(0.0)
        if len(limits.shifts):
            k = own - first[nodes]
            chosen = np.flatnonzero((k >= 0) & (k < count[nodes])), k[(k >= 0) & (k < count[nodes])]
            costs_of_own = costs[chosen]
            for shift in limits.shifts:
                np.minimum(costs, costs_of(shift), out=costs)
            costs[chosen] = costs_of_own
        least = np.empty(len(groups), np.float32)
        order_margins.least_margins(
            group, own, first[nodes], count[nodes], costs, order_margins.LEAST_SHARE, order_margins.LARGEST_COST,
            limits.even, least,
        )  # fmt: skip
        return least

    def reject_contradicted(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, other_view: View, order: NDArray[np.int16]
    ) -> None:
        """As of :class:`OrderSearch`."""
        view, table, s, theirs = self._view, self.table, self._view.settings, other_view.table
        place, value, cost = np.empty(order.shape, np.int32), np.empty(order.shape, np.float32), self._weight
        uniqueness.claims(
            blocks(len(order), uniqueness.ROWS), self.order, table.top, table.down, table.left, table.step, self._rays,
            reference.phase, reference.descriptors, other.descriptors, view.phase_to_column, view.linear,
            self._limit_orders(correction, 1), np.float32(view.extent), view.labels, view.first_axis,
            np.float32(0.5 / s.cost_sigma**2), np.float32(s.texture_weight), theirs.top, theirs.down, theirs.left,
            theirs.step, theirs.shape, np.float32(other_view.slopes[0]), np.float32(other_view.slopes[1]), place,
            value, cost,
        )  # fmt: skip
        uniqueness.reject_contradicted(
            place.reshape(-1), value.reshape(-1), cost.reshape(-1), np.float32(s.consistency_threshold),
            np.empty(theirs.shape[0] * theirs.shape[1], np.int32), order.reshape(-1),
        )  # fmt: skip

    def decide(self, reference: PhaseMap) -> None:
        """Aggregate along the columns, and decide."""
        view, table = self._view, self.table
        penalty = view.settings.switch_penalty
        phase_links.column_links(
            len(self._jump), reference.phase, reference.valid, table.top, table.down, table.left, table.step,
            np.float32(view.slopes[1]), self.count, self._jump, self._weight,
        )  # fmt: skip
        semi_global_aggregation.along_columns(
            blocks(table.shape[1], semi_global_aggregation.BLOCK), self.costs, self.first, self.count, self._jump,
            self._weight, np.float32(penalty), view.labels, np.float32(CONFIDENT_LEAD * penalty), self._total,
            self.order, self.confident,
        )  # fmt: skip
