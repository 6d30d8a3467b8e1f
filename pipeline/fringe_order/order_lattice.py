"""Candidates, costs and decisions of one lattice's pixels, in arrays that every pair uses again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import blocks
from pipeline.common.tile_math import TILE
from pipeline.decode.decoder import PhaseMap
from pipeline.fringe_order import order_candidates, phase_links, semi_global_aggregation, strip_search
from pipeline.fringe_order.label_vectors import padded
from pipeline.fringe_order.margins import order_margins
from pipeline.fringe_order.margins.sampled_groups import Groups
from pipeline.fringe_order.visibility import uniqueness
from pipeline.fringe_order.visibility.order_jumps import Jumps, Segments
from pipeline.fringe_order.visibility.uniqueness import Claims
from pipeline.fringe_order.visibility.visibility_test import may_have_parts, nearest_claims, unseen_segments
from pipeline.geometry.ray_tables import RayTable
from pipeline.geometry.view_tables import View

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

CONFIDENT_LEAD = 2.5
"""Lead of the best order's total cost over the second best, in switch penalties, from which it is confident."""


class OrderLattice:
    """The orders of a lattice's pixels, by costs of their candidates.

    Args:
        table: of the lattice's rays; by_brightness: jumps of the order cost less where the brightness changes.
    """

    def __init__(self, view: View, table: RayTable, *, by_brightness: bool) -> None:
        h, w = table.shape
        self._by_brightness, self._contrast = by_brightness, (np.float32(0), np.float32(0))
        self._view, self.table = view, table
        self._texture_weight = view.settings.texture_weight
        self._rays = np.zeros((h, w, order_candidates.RAY), np.float32)
        self._rays[..., : len(table.lines)] = np.moveaxis(table.lines, 0, -1)
        self.labels = padded(view.labels)
        # Only the elements of searched pixels are ever written; one more, so that every pixel's end is an element.
        self.costs, self._total = (np.zeros(h * w * self.labels + 1, np.float32) for _ in range(2))
        self.first, self.count, self.place = (np.zeros((h, w), np.int32) for _ in range(3))
        self._jump, self._weight = np.empty((h, w), np.int32), np.empty((h, w), np.float32)
        self._limited: tuple[F64, int] | None = None
        self._segments = Segments((h, w))
        self.order = np.full((h, w), semi_global_aggregation.NONE, np.int16)
        self.confident = np.empty((h, w), np.uint8)
        self.expected = np.full((h, w), np.nan, np.float32)
        self.certain = np.full((h, w), semi_global_aggregation.NONE, np.int16)

    def weight_texture(self, share: float) -> None:
        """Use a share of the settings' weight of the texture from now on."""
        self._texture_weight = share * self._view.settings.texture_weight

    def search_rows(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, texture: float, refresh: int, stride: int
    ) -> None:
        """Compute the candidates' costs at the pixels that are not certain, and aggregate along the rows.

        Args:
            texture: share of the texture's weight; refresh, stride: as of :mod:`.strip_search`.
        """
        view, table, s = self._view, self.table, self._view.settings
        single = self._limit_orders(correction, stride)
        if self._by_brightness:
            along, across = phase_links.contrast_factors(
                reference.brightness, reference.valid, table.top, table.down, table.shape[0], table.left, table.step,
                table.shape[1],
            )  # fmt: skip
            self._contrast = np.float32(along), np.float32(across)  # a kernel's numbers arrive in double precision
        strip_search.search_rows(
            blocks(table.shape[0], strip_search.STRIP), table.top, table.down, table.left, table.step, stride,
            self._rays, reference.phase, reference.descriptors, reference.valid, reference.brightness,
            self._contrast[0], other.descriptors, view.phase_to_column, view.linear, single, np.float32(view.extent),
            self.labels, view.first_axis, np.float32(view.slopes[0]), np.float32(0.5 / s.cost_sigma**2),
            np.float32(texture * self._texture_weight), np.float32(s.switch_penalty), self.certain, self.expected,
            refresh, np.float32(s.follow_cost), self.costs, self._total, self.first, self.count, self.place,
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
        order: NDArray[np.int16], stride: int, groups: Groups, continued: order_margins.Continued,
    ) -> NDArray[np.float32]:  # fmt: skip
        """(groups,) least margins of the orders; only lattice pixels in rows and columns of the stride count."""
        view, table, s = self._view, self.table, self._view.settings
        h, w = table.shape
        rows, columns = table.top + table.down * np.arange(h), table.left + table.step * np.arange(w)
        nodes, group = groups.sampled(*(np.where(x % stride == 0, x // stride, -1) for x in (rows, columns)))
        i, j = rows[nodes // w], columns[nodes % w]
        first, count = np.empty(h * w, np.int32), np.empty(h * w, np.int32)
        single = self._limit_orders(correction, 1)
        pixels = (i * reference.phase.shape[1] + j).astype(np.int32)

        def costs_of(shift: float) -> F32:
            shifted, costs = single.copy(), np.empty((len(nodes), view.labels), np.float32)
            shifted[0] += shift
            order_margins.costs_of_nodes(
                blocks(len(nodes), TILE), nodes, pixels, self._rays, reference.phase,
                reference.descriptors, other.descriptors, view.phase_to_column, view.linear, shifted,
                np.float32(view.extent), view.labels, view.first_axis, np.float32(0.5 / s.cost_sigma**2),
                np.float32(order_margins.TEXTURE * self._texture_weight), first, count, costs,
            )  # fmt: skip
            return costs

        def least_margins(costs: F32) -> F32:
            least = np.empty(len(groups), np.float32)
            order_margins.least_margins(
                group, own, first[nodes], count[nodes], costs, order_margins.LEAST_SHARE, order_margins.LARGEST_COST,
                limits.largest_own, limits.even, order_margins.UNEXPLAINED, continued.change, continued.share,
                continued.unconfirmed, least,
            )  # fmt: skip
            return least

        own, costs = order[i // stride, j // stride], costs_of(0.0)
        least = least_margins(costs)
        if len(limits.shifts):
            k = own - first[nodes]
            chosen = np.flatnonzero((k >= 0) & (k < count[nodes])), k[(k >= 0) & (k < count[nodes])]
            costs_of_own = costs[chosen]
            for shift in limits.shifts:
                # The projector has one offset: all pixels have other orders at the same one.
                costs = costs_of(shift)
                costs[chosen] = costs_of_own
                least = np.minimum(least, least_margins(costs))
        return least

    def reject_contradicted(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, other_view: View, order: NDArray[np.int16]
    ) -> None:
        """As of :class:`OrderSearch`."""
        place, value, cost = self._claims(self.order, reference, other, correction, other_view)
        limit = np.float32(self._view.settings.consistency_threshold)
        least = np.empty(other_view.table.shape[0] * other_view.table.shape[1], np.int32)
        uniqueness.reject_contradicted(
            place.reshape(-1), value.reshape(-1), cost.reshape(-1), limit, least, order.reshape(-1)
        )

    def reject_unseen(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, other_view: View, place: NDArray[np.int32],
        order: NDArray[np.int16],
    ) -> None:  # fmt: skip
        """As of :class:`OrderSearch`."""
        view, t, theirs, segments = self._view, self.table, other_view.table.shape, self._segments
        axis, nearer = view.first_axis, towards_nearer(view, other_view)
        owner = np.full(theirs[0] * theirs[1], -1, np.int32)
        nearest_claims(place, axis, nearer, owner)

        def claims_of(orders: NDArray[np.int16]) -> Claims:
            return self._claims(orders, reference, other, correction, other_view)

        def reject(jumps: Jumps) -> None:
            unseen = unseen_segments(
                segments.label, segments.sizes, jumps, self.order, order, owner, claims_of, axis, nearer,
                view.settings.cluster_min_area // (t.down * t.step),
            )  # fmt: skip
            if unseen.any():
                order[np.concatenate([[False], unseen])[segments.label]] = semi_global_aggregation.NONE

        jumps = segments.find(
            self.order, t.top, t.down, t.left, t.step, reference.phase, reference.descriptors, view.slopes
        )
        in_parts = may_have_parts(jumps, segments.sizes)
        reject(jumps)
        if in_parts:
            # Wrong orders may meet those of a right surface by chance, mostly at the edge of a shadow.
            reject(segments.divide())

    def _claims(
        self, order: NDArray[np.int16], reference: PhaseMap, other: PhaseMap, correction: F64, other_view: View
    ) -> Claims:
        """Claims of orders (h, w), or of none of them (0, 0)."""
        view, table, s, theirs = self._view, self.table, self._view.settings, other_view.table
        place = np.empty(order.shape, np.int32)
        value, cost = (np.empty(order.shape, np.float32) for _ in range(2))
        uniqueness.claims(
            blocks(len(order), uniqueness.ROWS), order, table.top, table.down, table.left, table.step, self._rays,
            reference.phase, reference.descriptors, other.descriptors, view.phase_to_column, view.linear,
            self._limit_orders(correction, 1), np.float32(view.extent), view.labels, view.first_axis,
            np.float32(0.5 / s.cost_sigma**2), np.float32(self._texture_weight), theirs.top, theirs.down, theirs.left,
            theirs.step, theirs.shape, np.float32(other_view.slopes[0]), np.float32(other_view.slopes[1]), place,
            value, cost,
        )  # fmt: skip
        return Claims(place, value, cost)

    def decide(self, reference: PhaseMap) -> None:
        """Aggregate along the columns, and decide."""
        view, table = self._view, self.table
        penalty = view.settings.switch_penalty
        phase_links.column_links(
            len(self._jump), reference.phase, reference.valid, reference.brightness, self._contrast[1], table.top,
            table.down, table.left, table.step, np.float32(view.slopes[1]), self.count, self._jump, self._weight,
        )  # fmt: skip
        semi_global_aggregation.along_columns(
            blocks(table.shape[1], semi_global_aggregation.BLOCK), self.costs, self.place, self.first, self.count,
            self._jump, self._weight, np.float32(penalty), self.labels, np.float32(CONFIDENT_LEAD * penalty),
            self._total, self.order, self.confident,
        )  # fmt: skip


def towards_nearer(view: View, other: View) -> int:
    """1 or -1: along the growth of the phase, where nearer points lie of those that the other camera sees as one."""
    t = view.table
    a, m = (planes[:3, t.shape[0] // 2, t.shape[1] // 2] for planes in (t.along, t.lines))
    # How the ray's image moves with 1 / z: projector coordinate by s times the other camera's by that coordinate.
    moves = (a[1] - a[0] * a[2]) * (m[1] - m[0] * m[2])
    return int(-np.sign(moves * view.slopes[view.first_axis] * other.slopes[view.first_axis]))
