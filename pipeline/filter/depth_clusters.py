"""Small clusters: points that hang together by depth, and too few of them to be a surface.

Surfaces are found by phase and match before, where a step in depth of a small part of a fringe order is no border. What
the tests leave of a false surface may hang together with a true one by points that are rejected later, such as those on
blurred steps. So points are grouped once more, by the depth itself, after all tests: neighbours belong to one cluster
where the surface between them is not too steep to be measured.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.common.jit import linked
from pipeline.filter.surfaces.component_test import reject_surfaces
from pipeline.filter.surfaces.small_surfaces import narrow

LARGEST_TANGENT = 6.0
"""Tangent of the steepest slope, to the image plane, between neighbours of one cluster."""


def largest_step(focal_px: float, stride: int) -> np.float32:
    """Change of the depth up to which neighbours belong to one cluster, by depth."""
    return np.float32(LARGEST_TANGENT * stride / focal_px)


@linked
def link_row(depth: Any, k: int, border: int, most_x: Any, most_y: Any, on_step: Any, known: Any, link: Any) -> None:
    """Points and links of row k of ``depth``, which has a border of unknown points.

    Args:
        most_x, most_y: of :func:`largest_step`.
        on_step: (W,) 1 where a point is on a blurred step, so that it is unknown.
        known, link: (W,) uint8, written: 1 where there is a point; bits LEFT and UP.
    """
    n, end = border, border + link.shape[0]
    z, before, above = depth[k, n:end], depth[k, n - 1 : end - 1], depth[k - 1, n:end]
    for j in range(link.shape[0]):
        known[j] = np.uint8((z[j] == z[j]) & (on_step[j] == 0))
        left, up = abs(z[j] - before[j]) <= most_x * z[j], abs(z[j] - above[j]) <= most_y * z[j]
        link[j] = LEFT * np.uint8(left) | UP * np.uint8(up)


class Clusters:
    """For images of one shape, in arrays that every call uses again.

    Args:
        smallest: pixels of the smallest cluster; stride: step of these pixels in the camera's image.

    ``known`` and ``link``, both (H, W) uint8, are those of :func:`link_row`, for the caller to write.
    """

    def __init__(self, shape: tuple[int, int], smallest: int, stride: int) -> None:
        self.known, self.link = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
        self._surfaces, self._smallest, self._stride = Surfaces(shape), smallest, stride

    def reject_small(self) -> None:
        """Set ``known`` to 0 at the points of small and narrow clusters."""
        f = self._surfaces
        f.find(self.known, self.link, self._smallest)
        thin = narrow(f, self._smallest, self._stride)
        reject_surfaces(len(self.known), thin, f.start, f.stop, f.count, f.first, f.surface, self.known)
