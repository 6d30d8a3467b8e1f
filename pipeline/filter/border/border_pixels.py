"""Pixels at the border of a surface, in the left image or along the row in the right one."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import allocating_linked, serial
from pipeline.match.match_result import PIXEL_STEPS

REACH = 2
"""Half width of the neighbourhood that is compared, pixels."""
RIGHT_STEPS = 3 * PIXEL_STEPS // 2
"""Distance in the right image up to which a pixel counts as near the border, whose window may straddle it there."""
FARTHEST = 6
"""Farthest such pixel in the left image, pixels."""
ROWS = 8
"""Rows that share their scratch arrays."""
_NO = np.uint8(0)


@serial
def changes_of_row(label: Any, i: int, across: Any, down: Any) -> None:
    """1 where labels change within reach along a row, and where they change to the row below; 0 at the row's ends.

    Args:
        label: (H, W) uint16; across, down: (W,) uint8, written; the second only above the last row.
    """
    height, width = label.shape
    here, n = label[i], width - 2 * REACH
    a, b, c, d, e = here[:n], here[1 : n + 1], here[2 : n + 2], here[3 : n + 3], here[4 : n + 4]
    inner = across[REACH : n + REACH]
    for j in range(n):
        inner[j] = np.uint8((a[j] != b[j]) | (b[j] != c[j]) | (c[j] != d[j]) | (d[j] != e[j]))
    if i + 1 < height:
        below = label[i + 1]
        for j in range(width):
            down[j] = np.uint8(here[j] != below[j])


@serial
def border_of_row(label: Any, right_u: Any, i: int, across: Any, down: Any, out: Any) -> None:
    """1 where the border of the pixel's surface lies within its reach, or near along the row in the right image.

    A neighbourhood has a border if labels change along one of its rows, or from row to row in its middle column.

    Args:
        label: (H, W) uint16; right_u: (H, W) uint16, steps; out: (W,) uint8.
        across, down: (5, W) uint8, of :func:`changes_of_row`, row i of the image in row i % 5.
    """
    height, width = label.shape
    out[:] = _NO
    if i < REACH or i >= height - REACH:
        return
    here, inner, n = label[i], out[REACH : width - REACH], width - 2 * REACH
    for t in range(5):
        row = across[t, REACH : n + REACH]
        for j in range(n):
            inner[j] |= row[j]
    for t in range(i - REACH, i + REACH):
        row = down[t % 5, REACH : n + REACH]
        for j in range(n):
            inner[j] |= row[j]
    u = right_u[i]
    for d in range(REACH + 1, FARTHEST + 1):
        near, far, edge = here[: width - d], here[d:], here[d - 1 : width - 1]
        first, last = u[: width - d], u[d - 1 : width - 1]
        ahead = out[: width - d]
        for j in range(width - d):
            close = np.uint16(last[j] - first[j] + RIGHT_STEPS) <= np.uint16(2 * RIGHT_STEPS)
            ahead[j] |= np.uint8((far[j] != near[j]) & (edge[j] == near[j]) & close)
        near, far, edge = here[d:], here[: width - d], here[1 : width - d + 1]
        first, last = u[d:], u[1 : width - d + 1]
        behind = out[d:]
        for j in range(width - d):
            close = np.uint16(last[j] - first[j] + RIGHT_STEPS) <= np.uint16(2 * RIGHT_STEPS)
            behind[j] |= np.uint8((far[j] != near[j]) & (edge[j] == near[j]) & close)
    for j in range(width):
        out[j] = out[j] if here[j] != 0 else _NO
    out[:REACH], out[width - REACH :] = _NO, _NO


@allocating_linked
def pixels_of_band(label: Any, right_u: Any, band: int, at: Any) -> int:
    """Border pixels of a band into ``at`` (ROWS W + 1, 2) int32, rows and columns; their number."""
    height, width = label.shape
    across, down = np.zeros((5, width), np.uint8), np.zeros((5, width), np.uint8)
    border = np.zeros(8 * ((width + 7) // 8), np.uint8)
    # Most pixels are inside a surface: eight of them are passed at once.
    eights = border.view(np.uint64)
    top, n = band * ROWS, 0
    for i in range(max(top - REACH, 0), min(top + REACH, height)):
        changes_of_row(label, i, across[i % 5], down[i % 5])
    for i in range(top, min(top + ROWS, height)):
        if i + REACH < height:
            changes_of_row(label, i + REACH, across[(i + REACH) % 5], down[(i + REACH) % 5])
        border_of_row(label, right_u, i, across, down, border[:width])
        for eight in range(eights.shape[0]):
            if eights[eight] != 0:
                for j in range(8 * eight, 8 * eight + 8):
                    at[n, 0], at[n, 1] = i, j
                    n += border[j]
    return n
