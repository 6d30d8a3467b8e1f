"""Rejection of what other tests have left of a false surface: small or narrow surfaces, and their surroundings.

Texture and uniqueness contradict a false surface at most of its pixels, and leave parts where both agree by chance: of
a wall that the other camera does not see, matched to another part of it. A true surface loses pixels at its edges only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import Surfaces
from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel, parallel_allocating
from pipeline.filter.occlusion.uniqueness import PARTS
from pipeline.filter.surfaces.component_test import reject_surfaces

LARGEST_LOSS, RELIABLE = 0.18, 8
"""Share of its points that a small surface may lose at its border; times the smallest size, that of a large one."""
LEAST_WIDTH = 4.0
"""Pixels; each pixel of a narrower surface straddles its borders, so that nothing confirms it."""
RADIUS = 10
"""Pixels around a surface that are its surroundings."""
MOST_CONTRADICTED = 0.45
"""Share of the pixels in and around a small surface that may be contradicted, of those that matched as one surface."""
_YES = np.uint8(1)


def reject_contradicted(
    before: NDArray[np.uint8], valid: NDArray[np.uint8], label: NDArray[np.uint16], surfaces: Surfaces, large: int,
    stride: int,
) -> None:  # fmt: skip
    """Reject small surfaces most of whose surroundings were rejected; ``valid`` is changed.

    Args:
        before: (H, W) of the points before the tests that may contradict them; valid: after them.
        label: of the surfaces before.
        surfaces: those of ``valid``; large: pixels from which a surface is not tested.
        stride: step of these pixels in the camera's image.
    """
    f = surfaces
    number = len(f.sizes)
    counts = np.zeros((number, 2), np.int64)
    count_surroundings(
        number, boxes_of(f), f.sizes, large, max(RADIUS // stride, 1), f.start, f.stop, f.count, f.first, f.surface,
        before, valid, label, counts,
    )  # fmt: skip
    contradicted, left = counts.T
    rejected = contradicted > MOST_CONTRADICTED * (contradicted + left)
    reject_surfaces(len(valid), rejected, f.start, f.stop, f.count, f.first, f.surface, valid)


def reject_eroded(valid: NDArray[np.uint8], surfaces: Surfaces, smallest: int) -> None:
    """Reject small surfaces of which the border test left too little; ``valid`` is changed.

    False surfaces have probably wrong points all along their borders.

    Args:
        smallest: pixels of the smallest connected surface.
    """
    f = surfaces
    total = np.zeros((PARTS, len(f.sizes)), np.int64)
    _count(PARTS, valid, f.start, f.stop, f.count, f.first, f.surface, total)
    remaining = total.sum(axis=0)
    rejected = (f.sizes < RELIABLE * smallest) & (remaining < (1 - LARGEST_LOSS) * f.sizes)
    reject_surfaces(len(valid), rejected, f.start, f.stop, f.count, f.first, f.surface, valid)


def narrow(surfaces: Surfaces, smallest: int, stride: int) -> NDArray[np.bool_]:
    """Which surfaces (n,) are small and have less than LEAST_WIDTH pixels on average.

    Args:
        smallest: as of :func:`reject_eroded`; stride: as of :func:`reject_contradicted`.
    """
    top, bottom, left, right = boxes_of(surfaces).T
    length = np.maximum(bottom - top, right - left) + 1
    return (surfaces.sizes < RELIABLE * smallest) & (stride * surfaces.sizes < LEAST_WIDTH * length)


def boxes_of(surfaces: Surfaces) -> NDArray[np.int32]:
    """First and last row, first and last column (n, 4) of each surface."""
    f = surfaces
    box = np.empty((len(f.sizes), 4), np.int32)
    boxes(f.start, f.stop, f.count, f.first, f.surface, box)
    return box


@parallel
def _count(part: int, valid: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, total: Any) -> None:
    """Valid pixels of surfaces, (PARTS, surfaces) int64."""
    height = valid.shape[0]
    parts = total.shape[0]
    for i in range(part * height // parts, (part + 1) * height // parts):
        for t in range(count[0, i]):
            k = surface[row[i] + t]
            if k >= 0:
                for j in range(start[i, t], stop[i, t]):
                    total[part, k] += valid[i, j]


@serial
def boxes(start: Any, stop: Any, count: Any, row: Any, surface: Any, box: Any) -> None:
    """First and last row, first and last column (n, 4) int32 of each surface."""
    box[:, 0::2] = np.int32(2**30)
    box[:, 1::2] = np.int32(-1)
    for i in range(count.shape[1]):
        for t in range(count[0, i]):
            k = surface[row[i] + t]
            if k >= 0:
                box[k, 0], box[k, 1] = min(box[k, 0], i), max(box[k, 1], i)
                box[k, 2], box[k, 3] = min(box[k, 2], start[i, t]), max(box[k, 3], stop[i, t] - 1)


@parallel_allocating
def count_surroundings(
    k: int, box: Any, sizes: Any, large: int, radius: int, start: Any, stop: Any, count: Any, row: Any, surface: Any,
    before: Any, valid: Any, label: Any, counts: Any,
) -> None:  # fmt: skip
    """Pixels (n, 2) of the same surface before, in and around a surface: those rejected since, and those left."""
    if sizes[k] >= large:
        return
    height, width = valid.shape
    top, bottom = max(box[k, 0] - radius, 0), min(box[k, 1] + radius + 1, height)
    left, right = max(box[k, 2] - radius, 0), min(box[k, 3] + radius + 1, width)
    near = np.zeros((bottom - top, right - left), np.uint8)
    own = np.uint16(0)
    for i in range(box[k, 0], box[k, 1] + 1):
        for t in range(count[0, i]):
            if surface[row[i] + t] == k:
                own = label[i, start[i, t]]
                begin, end = max(start[i, t] - radius, left) - left, min(stop[i, t] + radius, right) - left
                for y in range(max(i - radius, top) - top, min(i + radius + 1, bottom) - top):
                    near[y, begin:end] = _YES
    for y in range(bottom - top):
        for x in range(right - left):
            if near[y, x] and before[top + y, left + x] and label[top + y, left + x] == own:
                counts[k, 1 if valid[top + y, left + x] else 0] += 1
