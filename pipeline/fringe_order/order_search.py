"""The fringe orders of one camera's lattice pixels, in arrays that every pair uses again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.fringe_order import order_candidates, phase_links, semi_global_aggregation
from pipeline.fringe_order import strip_search as search
from pipeline.fringe_order.coarse_to_fine import settle
from pipeline.geometry.ray_tables import RayTable

if TYPE_CHECKING:
    from pipeline.decode.decoder import PhaseMap
    from pipeline.geometry.view_tables import View

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

NO_TURN = -1
"""Search every row without expectations."""
SURE = 2.5
"""Lead of the best order's total cost over the second best, in switch penalties, from which it is sure."""


class OrderSearch:
    """Search from the side of one view: on every second lattice pixel, then where that leaves something open."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._coarse, self._fine = _Lattice(view, view.table.every_second()), _Lattice(view, view.table)
        self._turn, self._expects = 0, False

    def mean_best_cost(self, here: PhaseMap, there: PhaseMap, correction: F64, *, stride: int) -> float:
        """Mean least cost of the pixels with two candidates at least, on every n-th lattice row."""
        level = self._fine
        level.settled[:] = semi_global_aggregation.NONE
        level.price(here, there, correction, NO_TURN, stride)
        count = level.count[::stride]
        several = count >= 2
        if not several.any():
            return 0.0
        costs = level.costs[::stride].reshape(*count.shape, self._view.labels)
        there_are = np.arange(self._view.labels) < count[..., None]
        return float(np.where(there_are, costs, np.inf).min(axis=2)[several].mean(dtype=np.float64))

    def search(self, here: PhaseMap, there: PhaseMap, correction: F64, *, use_prior: bool) -> NDArray[np.int16]:
        """Orders (h, w) of the lattice pixels, valid until the next call.

        Args:
            here, there: phases of this camera's image and of the other's.
            use_prior: look only near what :meth:`expect` was told last, but for a few rows in turn.
        """
        coarse, fine, table, view = self._coarse, self._fine, self._view.table, self._view
        if use_prior and self._expects:
            # One look at each pixel is less than what a quarter of them and the way between takes.
            self._turn = (self._turn + 1) % search.REFRESH
            fine.settled[:] = semi_global_aggregation.NONE
            fine.price(here, there, correction, self._turn, 1)
        else:
            coarse.price(here, there, correction, NO_TURN, 1)
            coarse.decide(here)
            settle(
                coarse.order, coarse.sure, here.phase, here.valid, table.top, table.down, table.left, table.step,
                np.float32(view.slopes[0]), np.float32(view.slopes[1]), fine.settled,
            )  # fmt: skip
            fine.price(here, there, correction, NO_TURN, 1)
        fine.decide(here)
        return fine.order

    def expect(self, here: PhaseMap, order: NDArray[np.int16]) -> None:
        """Expect these orders (h, w) of the last search, where they were cheap, in the next one."""
        fine, v, t = self._fine, self._view, self._view.table
        search.remember(
            order, fine.settled, fine.first, fine.count, fine.costs, v.labels, np.float32(v.settings.follow_cost),
            t.top, t.down, t.left, t.step, here.phase, fine.expected,
        )  # fmt: skip
        self._expects = True

    def forget(self) -> None:
        """Expect nothing in the next search."""
        self._turn, self._expects = 0, False


class _Lattice:
    """Candidates, prices and decisions of one lattice's pixels.

    Args:
        table: of the lattice's rays.
    """

    def __init__(self, view: View, table: RayTable) -> None:
        h, w = table.shape
        self._view, self.table = view, table
        self._rays = np.zeros((h, w, order_candidates.RAY), np.float32)
        self._rays[..., : len(table.lines)] = np.moveaxis(table.lines, 0, -1)
        # Only what is searched is ever touched of these two.
        self.costs, self._total = (np.zeros((h, w * view.labels), np.float32) for _ in range(2))
        self.first, self.count = np.zeros((h, w), np.int32), np.zeros((h, w), np.int32)
        self._jump, self._trust = np.empty((h, w), np.int32), np.empty((h, w), np.float32)
        self._correction: F64 | None = None
        self.order, self.sure = np.empty((h, w), np.int16), np.empty((h, w), np.uint8)
        self.expected = np.full((h, w), np.nan, np.float32)
        self.settled = np.full((h, w), semi_global_aggregation.NONE, np.int16)

    def price(self, here: PhaseMap, there: PhaseMap, correction: F64, turn: int, stride: int) -> None:
        """Price the candidates of the pixels that are not settled, and aggregate along the rows."""
        view, table, s = self._view, self.table, self._view.settings
        single = correction.astype(np.float32)
        if self._correction is None or not np.array_equal(correction, self._correction):
            order_candidates.order_limits(table.along, table.limits, view.phases, single, self._rays)
            self._correction = correction.copy()
        search.search_rows(
            table.top, table.down, table.left, table.step, stride, self._rays,
            here.phase, here.descriptors, here.valid, there.descriptors,
            view.columns, view.linear, single, np.float32(view.extent), view.labels, view.first_axis,
            np.float32(view.slopes[0]), np.float32(0.5 / s.cost_sigma**2), np.float32(s.texture_weight),
            np.float32(s.switch_penalty),
            self.settled, self.expected, turn, np.float32(s.follow_cost),
            self.costs, self._total, self.first, self.count,
        )  # fmt: skip

    def decide(self, here: PhaseMap) -> None:
        """Aggregate along the columns, and decide."""
        view, table = self._view, self.table
        penalty = view.settings.switch_penalty
        phase_links.column_links(
            here.phase, here.valid, table.top, table.down, table.left, table.step, np.float32(view.slopes[1]),
            self.count, self._jump, self._trust,
        )  # fmt: skip
        semi_global_aggregation.along_columns(
            self.costs, self.first, self.count, self._jump, self._trust, np.float32(penalty), view.labels,
            np.float32(SURE * penalty), self._total, self.order, self.sure,
        )  # fmt: skip
