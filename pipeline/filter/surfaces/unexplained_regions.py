"""Small surfaces that are left in a large region whose fringes no point explains.

A wall farther than orders are searched is such a region: its fringes are clear, and no order suits it. Here and there
one agrees by chance, in both images and with the projector, and a small surface stays. It lies in the region as a part
of it: phase and brightness go on across its border. A true surface in front of such a wall ends at depth edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.common.parallel_for import parallel
from pipeline.filter.surfaces.component_test import reject_surfaces
from pipeline.filter.surfaces.small_surfaces import boxes_of
from pipeline.filter.surfaces.surface_evidence import Figures
from pipeline.filter.surfaces.unconfirmed_surfaces import LEAST_LOSS
from pipeline.fringe_order.margins.order_margins import Continued

REGION_SHARE, TIMES_SURFACE = 0.1, 50
"""Share of the image that a region has at least, and how many times as large as a surface that is rejected it is."""
LEAST_OPEN = 0.4
"""Share of the places along the border where phase and brightness go on to pixels without a point, or with another
order."""
_BEYOND = 2
"""Pixels from a surface's outermost ones to those that are looked up: there may be a rejected seam between."""


class UnexplainedRegions:
    """For one image size, in arrays that every call uses again."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._regions, self._label = Surfaces(shape), np.empty(shape, np.uint16)
        self._link = np.full(shape, LEFT | UP)

    def reject_remains(
        self, usable: NDArray[np.bool_], valid: NDArray[np.uint8], label: NDArray[np.uint16], surfaces: Surfaces,
        figures: Figures, continued: Continued, matched_loss: float, large: int,
    ) -> None:  # fmt: skip
        """Reject small surfaces that are left in a large region without points; ``valid`` (H, W) is changed.

        Args:
            usable: (H, W) pixels with fringes; label: (H, W), one more than the surface.
            figures, continued: of the surfaces. matched_loss: of :class:`pipeline.filter.texture_agreement.Scale`.
            large: pixels from which a surface is not tested.
        """
        f = surfaces
        doubtful = (f.sizes < large) & (continued.open >= LEAST_OPEN)
        doubtful &= figures.mean_loss >= LEAST_LOSS * matched_loss
        number = self._find(usable, valid) if doubtful.any() else 0
        region_sizes = np.concatenate([np.zeros(1, np.int32), self._regions.sizes[:number]])
        beside = np.zeros(len(f.sizes), np.int32)
        # Also where there is no region, so that warming up compiles it.
        largest_beside(
            len(f.sizes) if number else 0, doubtful, boxes_of(f), f.start, f.stop, f.count, f.first, f.surface, label,
            self._label, region_sizes, beside,
        )  # fmt: skip
        rejected = beside >= TIMES_SURFACE * f.sizes.astype(np.int64)
        if rejected.any():
            reject_surfaces(len(valid), rejected, f.start, f.stop, f.count, f.first, f.surface, valid)

    def _find(self, usable: NDArray[np.bool_], valid: NDArray[np.uint8]) -> int:
        """Find the large regions; their number."""
        free = (usable & (valid == 0)).view(np.uint8)
        number = self._regions.find(free, self._link, int(REGION_SHARE * valid.size))
        self._regions.paint(self._label)
        return number


@parallel
def largest_beside(
    k: int, tested: Any, box: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, label: Any, region: Any,
    sizes: Any, beside: Any,
) -> None:  # fmt: skip
    """Pixels of the largest region beside surface ``k``, into ``beside`` (n,); 0 is kept where there is none.

    Args:
        tested: (n,) bool; box: of :func:`pipeline.filter.surfaces.small_surfaces.boxes_of`; label: of the surfaces.
        region: (H, W) uint16, one more than a pixel's region; sizes: (regions + 1,), the first one is 0.
    """
    if not tested[k]:
        return
    height, width = label.shape
    own = np.uint16(k + 1)
    for i in range(box[k, 0], box[k, 1] + 1):
        for t in range(count[0, i]):
            if surface[row[i] + t] != k:
                continue
            begin, end = start[i, t], stop[i, t]
            for d in range(1, _BEYOND + 1):
                beside[k] = max(beside[k], sizes[region[i, max(begin - d, 0)]])
                beside[k] = max(beside[k], sizes[region[i, min(end - 1 + d, width - 1)]])
            for y in (max(i - _BEYOND, 0), min(i + _BEYOND, height - 1)):
                for j in range(begin, end):
                    if label[y, j] != own:
                        beside[k] = max(beside[k], sizes[region[y, j]])
