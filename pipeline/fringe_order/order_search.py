"""The fringe orders of one camera's lattice pixels, in arrays that every pair uses again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.decode.decoder import PhaseMap
from pipeline.fringe_order import semi_global_aggregation, strip_search
from pipeline.fringe_order.coarse_to_fine import interpolate_orders
from pipeline.fringe_order.margins.order_margins import CLEAR_GAIN, Continued, Limits
from pipeline.fringe_order.margins.sampled_groups import CELL, Ambiguous, Groups
from pipeline.fringe_order.order_lattice import OrderLattice
from pipeline.geometry.view_tables import View

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

NO_PRIOR = -1
"""Search every row without the prior."""
UNCALIBRATED = 0.6
"""Share of the texture's weight while the column offset or the cameras' response is not known: at a wrong offset, and
with unequal cameras, right orders have different textures as well."""


class OrderSearch:
    """Order search of one view: on every second lattice pixel, then where that leaves pixels open.

    Args:
        by_brightness: jumps of the order cost less where the brightness changes.
    """

    def __init__(self, view: View, *, by_brightness: bool) -> None:
        self._view = view
        self._coarse = OrderLattice(view, view.table.every_second(), by_brightness=by_brightness)
        self._fine = OrderLattice(view, view.table, by_brightness=by_brightness)
        self._refresh, self._has_prior = 0, False

    def weight_texture(self, share: float) -> None:
        """Use a share of the settings' weight of the texture from now on."""
        for level in (self._coarse, self._fine):
            level.weight_texture(share)

    def least_costs(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, *, stride: int, texture: float = UNCALIBRATED
    ) -> NDArray[np.float32]:
        """(n,) least cost of each pixel with two candidates at least, on every n-th lattice row."""
        level = self._fine
        level.certain[:] = semi_global_aggregation.NONE
        level.search_rows(reference, other, correction, texture, NO_PRIOR, stride)
        some = level.count[::stride] >= 2
        first = level.place[::stride][some]
        # Of every two segments the second one is what lies between a pixel's candidates and the next one's.
        ends = np.stack([first, first + level.count[::stride][some]], axis=1).ravel()
        return np.asarray(np.minimum.reduceat(level.costs, ends)[::2], dtype=np.float32)

    def search(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, *, use_prior: bool, texture: float = 1.0
    ) -> NDArray[np.int16]:
        """Orders (h, w) of the lattice pixels, valid until the next call.

        Args:
            reference, other: phases of this camera's image and of the other's.
            use_prior: search only where the orders of :meth:`set_prior` are contradicted, and a few rows in rotation.
            texture: share of the texture's weight.
        """
        coarse, fine, table, view = self._coarse, self._fine, self._view.table, self._view
        if use_prior and self._has_prior:
            # Testing one candidate of each pixel takes less than searching a quarter of them and unwrapping in between.
            self._refresh = (self._refresh + 1) % strip_search.REFRESH
            fine.certain[:] = semi_global_aggregation.NONE
            fine.search_rows(reference, other, correction, texture, self._refresh, 1)
        else:
            coarse.search_rows(reference, other, correction, texture, NO_PRIOR, 1)
            coarse.decide(reference)
            interpolate_orders(
                coarse.order, coarse.confident, reference.phase, reference.valid,
                table.top, table.down, table.left, table.step,
                np.float32(view.slopes[0]), np.float32(view.slopes[1]), fine.certain,
            )  # fmt: skip
            fine.search_rows(reference, other, correction, texture, NO_PRIOR, 1)
        fine.decide(reference)
        return fine.order

    def reject_ambiguous(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, limits: Limits,
        order: NDArray[np.int16], stride: int, label: NDArray[np.uint16], sizes: NDArray[np.int32],
        continued: Continued, valid: NDArray[np.uint8],
    ) -> Ambiguous:  # fmt: skip
        """Reject surfaces, large ones in cells, whose orders do not win clearly, see :mod:`.margins.order_margins`.

        Args:
            order, label: (H / stride, W / stride) order, and one more than the surface, of every n-th pixel.
            sizes: pixels of each surface; continued: of the surfaces.
            valid: (H / stride, W / stride), changed.
        """
        if limits.margin <= 0:
            return Ambiguous(0.0, 0.0)
        groups = Groups(label, sizes, CELL // stride)
        margins = self._fine.margins(reference, other, correction, limits, order, stride, groups, continued)
        found = groups.reject(margins < limits.margin, limits.ambiguous_share, valid)
        # The second call has no rows where nothing is to be rejected.
        groups.reject_each(np.isfinite(margins) & (found.rejected > limits.most_rejected), valid)
        # Where hardly any pixel agrees with the offset, a device may have moved: what is wrong then shows it.
        return found if limits.gain >= CLEAR_GAIN else found._replace(kept=0.0)

    def reject_contradicted(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, other_view: View, order: NDArray[np.int16]
    ) -> None:
        """Change orders (h, w) to NONE where the last search's contradict them in the other image.

        See :mod:`.visibility.uniqueness`.
        """
        self._fine.reject_contradicted(reference, other, correction, other_view, order)

    def reject_unseen(
        self, reference: PhaseMap, other: PhaseMap, correction: F64, other_view: View, place: NDArray[np.int32],
        order: NDArray[np.int16],
    ) -> None:  # fmt: skip
        """Change orders (h, w) of strips that the other camera does not see to NONE, as the last search's show them.

        See :mod:`.visibility.visibility_test`; ``place`` (h, w): of :func:`.left_right_check.cross_check`.
        """
        self._fine.reject_unseen(reference, other, correction, other_view, place, order)

    def set_prior(self, reference: PhaseMap, order: NDArray[np.int16]) -> None:
        """Expect these orders (h, w) of the last search in the next one, where their cost was low."""
        fine, v, t = self._fine, self._view, self._view.table
        strip_search.update_prior(
            len(order), order, fine.certain, fine.first, fine.count, fine.costs, fine.place,
            np.float32(v.settings.follow_cost), t.top, t.down, t.left, t.step, reference.phase, fine.expected,
        )  # fmt: skip
        self._has_prior = True

    def clear_prior(self) -> None:
        """Expect nothing in the next search."""
        self._refresh, self._has_prior = 0, False
