"""The fringe orders of one camera's lattice pixels, in arrays that every pair uses again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline import aggregate, candidates, search
from pipeline.packed import PHASOR_SCALE

if TYPE_CHECKING:
    from pipeline.phase import PhaseMap
    from pipeline.view import View

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

NO_TURN = -1
"""Search every row without expectations."""


class OrderSearch:
    """Search from the side of one view."""

    def __init__(self, view: View) -> None:
        h, w = view.table.shape
        self._view = view
        self._start, self._stop = np.empty((h, w), np.float32), np.empty((h, w), np.float32)
        self._costs, self._total = (np.zeros((h, w * view.labels), np.float32) for _ in range(2))
        self._first, self._count = np.zeros((h, w), np.int32), np.zeros((h, w), np.int32)
        self._jump, self._trust = np.empty((h, w), np.int32), np.empty((h, w), np.float32)
        self._correction: F64 | None = None
        self._turn, self._expects = 0, False
        self._order = np.empty((h, w), np.int16)
        self._expected = np.full((h, w), np.nan, np.float32)

    def mean_best_cost(self, here: PhaseMap, there: PhaseMap, correction: F64, *, every: int) -> float:
        """Mean least cost of the pixels with two candidates at least, on every n-th lattice row."""
        self._price(here, there, correction, NO_TURN, every)
        count = self._count[::every]
        several = count >= 2
        if not several.any():
            return 0.0
        costs = self._costs[::every].reshape(*count.shape, self._view.labels)
        there_are = np.arange(self._view.labels) < count[..., None]
        return float(np.where(there_are, costs, np.inf).min(axis=2)[several].mean(dtype=np.float64))

    def search(self, here: PhaseMap, there: PhaseMap, correction: F64, *, follow: bool) -> NDArray[np.int16]:
        """Orders (h, w) of the lattice pixels, valid until the next call.

        Args:
            here, there: phases of this camera's picture and of the other's.
            follow: look only near what :meth:`expect` was told last, but for a few rows in turn.
        """
        view, table = self._view, self._view.table
        if follow and self._expects:
            self._turn = (self._turn + 1) % search.REFRESH
            self._price(here, there, correction, self._turn, 1)
        else:
            self._price(here, there, correction, NO_TURN, 1)
        aggregate.column_links(
            here.phase, here.valid, table.top, table.down, table.left, table.step, np.float32(view.slopes[1]),
            self._count, self._jump, self._trust,
        )  # fmt: skip
        aggregate.along_columns(
            self._costs, self._first, self._count, self._jump, self._trust, np.float32(view.settings.switch_penalty),
            view.labels, self._total, self._order,
        )  # fmt: skip
        return self._order

    def expect(self, here: PhaseMap, order: NDArray[np.int16]) -> None:
        """Expect these orders (h, w) of the last search, where they were cheap, in the next one."""
        t, v = self._view.table, self._view
        search.remember(
            order, self._first, self._costs, v.labels, np.float32(v.settings.follow_cost), t.top, t.down, t.left,
            t.step, here.phase, self._expected,
        )  # fmt: skip
        self._expects = True

    def forget(self) -> None:
        """Expect nothing in the next search."""
        self._turn, self._expects = 0, False

    def _price(self, here: PhaseMap, there: PhaseMap, correction: F64, turn: int, every: int) -> None:
        view, table, s = self._view, self._view.table, self._view.settings
        single = correction.astype(np.float32)
        if self._correction is None or not np.array_equal(correction, self._correction):
            candidates.order_limits(
                table.coefficients[0], table.coefficients[1], table.limits, view.phases, single, self._start, self._stop
            )
            self._correction = correction.copy()
        search.search_rows(
            table.top, table.down, table.left, table.step, every, table.coefficients, self._start, self._stop,
            here.phase, here.phasor, here.equalized, here.mean,
            here.valid, there.phasor, there.equalized, there.mean,
            view.columns, view.linear, single, np.float32(view.extent), view.labels, view.first_axis,
            np.float32(view.slopes[0]), np.float32((s.min_modulation * PHASOR_SCALE) ** 2),
            np.float32(0.5 / s.cost_sigma**2), np.float32(s.texture_weight), np.float32(s.switch_penalty),
            self._expected, turn, np.float32(s.follow_cost),
            self._costs, self._total, self._first, self._count,
        )  # fmt: skip
