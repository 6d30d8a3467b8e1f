"""Pixels at the edge of a surface, whose window straddles two surfaces: rejected, or given a larger sigma."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.filter.local_outliers import RADIUS

_NO = np.uint8(0)
ROWS = 8
"""Rows that share a scratch array."""
REACH = 2
"""Half width of the neighbourhood that is compared, pixels."""


@linked
def _label_changes(above: Any, here: Any, below: Any, out: Any) -> None:
    """1 where one of the eight neighbours has another label; the row's ends are edges."""
    n = here.shape[0]
    for j in range(1, n - 1):
        k = here[j]
        same = (above[j - 1] == k) & (above[j] == k) & (above[j + 1] == k) & (here[j - 1] == k)
        same &= (here[j + 1] == k) & (below[j - 1] == k) & (below[j] == k) & (below[j + 1] == k)
        out[j] = np.uint8((not same) & (k != 0))
    out[0], out[n - 1] = np.uint8(here[0] != 0), np.uint8(here[n - 1] != 0)


@linked
def _edge_score(label: Any, deviation: Any, losses: Any, i: int, j: int) -> tuple[Any, int]:
    """Mean loss of the surface's pixels within REACH, and how many of the eight neighbours belong to it."""
    height, width = label.shape
    k = label[i, j]
    total, n, beside = np.float32(0.0), 0, 0
    if REACH <= i < height - REACH and REACH <= j < width - REACH:
        # Without limits that depend on the pixel the compiler unrolls both loops.
        top, left = np.uint64(i - REACH), np.uint64(j - REACH)
        for a in range(np.uint64(2 * REACH + 1)):
            for b in range(np.uint64(2 * REACH + 1)):
                own = label[top + a, left + b] == k
                total += losses[deviation[top + a, left + b]] if own else np.float32(0.0)
                n += own
                beside += own & (abs(np.int64(a) - REACH) <= 1) & (abs(np.int64(b) - REACH) <= 1)
        return total / np.float32(n), beside - 1
    for y in range(max(0, i - REACH), min(height, i + REACH + 1)):
        for x in range(max(0, j - REACH), min(width, j + REACH + 1)):
            if label[y, x] == k:
                total += losses[deviation[y, x]]
                n += 1
                if abs(y - i) <= 1 and abs(x - j) <= 1:
                    beside += 1
    return total / np.float32(n), beside - 1


@linked
def _agrees_with_projector(label: Any, first: Any, second: Any, i: int, j: int, calm: Any) -> Any:
    """Whether a pixel inside a surface has a mean square of the smaller residual around it of at most ``calm``."""
    height, width = label.shape
    k, squares, n = label[i, j], np.int64(0), 0
    for y in range(max(0, i - RADIUS), min(height, i + RADIUS + 1)):
        for x in range(max(0, j - RADIUS), min(width, j + RADIUS + 1)):
            if label[y, x] == k:
                a, b = np.int64(first[y, x]), np.int64(second[y, x])
                squares += min(a * a, b * b)
                n += 1
            elif abs(y - i) <= REACH and abs(x - j) <= REACH:
                return False
    return squares <= n * calm


@parallel_allocating
def edge_test(
    block: int, label: Any, deviation: Any, losses: Any, high: int, limit: Any, per_neighbour: Any, misfit_of: Any,
    first: Any, second: Any, calm: int, misfit: Any, valid: Any,
) -> None:  # fmt: skip
    """Reject edge pixels, and pixels that deviate, whose surface does not agree in texture around them.

    Inside a surface a highlight, which the cameras see at different places, deviates as well, but its phases agree with
    the projector as those of the other surfaces do.

    Args:
        block: number of :data:`ROWS` rows.
        label: (H, W) uint16, one more than the surface; deviation: (H, W) uint8; losses: by deviation.
        high: deviation from which a pixel inside a surface is tested, too.
        limit: mean loss from which a pixel with all its neighbours is rejected; per_neighbour: less for each missing.
        misfit_of: (9,) uint8, least misfit by the number of neighbours that belong to the surface.
        first, second: (H, W) int16, residuals against the projector, steps; calm: mean square of the smaller one up to
            which the projector agrees, 0 where it does not distinguish orders.
        misfit: (H, W) uint8, raised; valid: (H, W) uint8, changed.
    """
    height, width = label.shape
    doubt = np.zeros(8 * ((width + 7) // 8), np.uint8)
    eights = doubt.view(np.uint64)
    for i in range(block * ROWS, min((block + 1) * ROWS, height)):
        _label_changes(label[max(i - 1, 0)], label[i], label[min(i + 1, height - 1)], doubt[:width])
        row, checked = deviation[i], valid[i]
        for j in range(width):
            doubt[j] = (doubt[j] | np.uint8((row[j] >= high) & (label[i, j] != 0))) & checked[j]
        # Most pixels are inside a surface: eight of them are passed at once.
        for eight in range(eights.shape[0]):
            if eights[eight] == 0:
                continue
            for j in range(8 * eight, 8 * eight + 8):
                if doubt[j] == 0:
                    continue
                loss, beside = _edge_score(label, deviation, losses, i, j)
                foreign = loss > limit - per_neighbour * np.float32(8 - beside)
                if foreign and not (calm > 0 and _agrees_with_projector(label, first, second, i, j, calm)):
                    checked[j] = _NO
                else:
                    misfit[i, j] = max(misfit[i, j], misfit_of[beside])
