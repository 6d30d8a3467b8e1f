"""Surfaces divided at the edges of the image's brightness, so that each part's fringe orders are judged alone.

Where the fringes repeat, a wall beside an object may get the orders that put it at the object's depth. Both are one
surface then, whose orders win as clearly as those of the object do. Most objects differ from what is behind them in
brightness: the links between pixels at such edges and all others are cut, and object, wall and the edge between them
are surfaces of their own (see :mod:`pipeline.fringe_order.margins.order_margins`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.common.jit import linked
from pipeline.common.parallel_for import blocks, parallel_allocating

REACH = 3
"""Pixels from an edge up to which a pixel is at it; windows and lens blur an edge over as many."""
CONTRAST_PERCENT, DARK = 15, 16
"""Difference over sum of the largest and the smallest brightness within that distance, from which there is an edge;
the second, counts, is added to the sum: the noise of dark surfaces is no edge."""
_ROWS = 16
_NO = np.uint8(0)


class DividedSurfaces:
    """The surfaces of one image size, divided at edges, in arrays that every call uses again."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.surfaces = Surfaces(shape)
        self.label = np.empty(shape, np.uint16)
        self._link = np.empty(shape, np.uint8)

    def find(
        self, valid: NDArray[np.uint8], brightness: NDArray[np.uint8], link: NDArray[np.uint8], smallest: int
    ) -> None:
        """Find the parts of at least ``smallest`` pixels; ``label`` (H, W) becomes one more than each pixel's.

        Args:
            valid, link: (H, W), as of :class:`pipeline.common.connected_components.Surfaces`; brightness: (H, W).
        """
        cut_links(blocks(len(link), _ROWS), brightness, link, self._link)
        self.surfaces.find(valid, self._link, smallest)
        self.surfaces.paint(self.label)


@linked
def _edges(brightness: Any, i: int, low: Any, high: Any, edge: Any) -> None:
    """1 where a pixel of row ``i`` is at an edge; ``low``, ``high`` (W + 2 REACH): scratch."""
    height, width = brightness.shape
    darkest, brightest = low[REACH : REACH + width], high[REACH : REACH + width]
    first = max(i - REACH, 0)
    for y in range(first, min(i + REACH, height - 1) + 1):
        row = brightness[y]
        for j in range(width):
            darkest[j] = row[j] if y == first else min(darkest[j], row[j])
            brightest[j] = row[j] if y == first else max(brightest[j], row[j])
    for j in range(REACH):
        low[j], high[j] = darkest[0], brightest[0]
        low[REACH + width + j], high[REACH + width + j] = darkest[width - 1], brightest[width - 1]
    for j in range(width):
        a, b = low[j], high[j]
        for d in range(1, 2 * REACH + 1):
            a, b = min(a, low[np.uint32(j + d)]), max(b, high[np.uint32(j + d)])
        least, most = np.int32(a), np.int32(b)
        edge[j] = np.uint8(100 * (most - least) > CONTRAST_PERCENT * (most + least + DARK))


@linked
def _cut(link: Any, edge: Any, above: Any, first: bool, out: Any) -> None:
    """The links of a row without those between a pixel at an edge and one that is not."""
    for j in range(out.shape[0]):
        left = LEFT if j > 0 and edge[j] == edge[np.uint32(max(j - 1, 0))] else _NO
        up = UP if not first and edge[j] == above[j] else _NO
        out[j] = link[j] & (left | up)


@parallel_allocating
def cut_links(band: int, brightness: Any, link: Any, out: Any) -> None:
    """Those of :data:`_ROWS` rows.

    Args:
        brightness: (H, W) uint8; link, out: (H, W) uint8, bits LEFT and UP, the second is written.
    """
    height, width = brightness.shape
    low, high = np.empty(width + 2 * REACH, np.uint8), np.empty(width + 2 * REACH, np.uint8)
    edge = np.empty((2, width), np.uint8)
    top = band * _ROWS
    if top > 0:
        _edges(brightness, top - 1, low, high, edge[(top + 1) % 2])
    for i in range(top, min(top + _ROWS, height)):
        here, above = edge[i % 2], edge[(i + 1) % 2]
        _edges(brightness, i, low, high, here)
        _cut(link[i], here, above, i == 0, out[i])
