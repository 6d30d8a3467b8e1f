"""Pixels at the border of a surface, in the left image or along the row in the right one."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import serial
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
def border_of_row(label: Any, right_u: Any, i: int, out: Any) -> None:
    """1 where the border of the pixel's surface lies within its reach, or near along the row in the right image.

    Args:
        label: (H, W) uint16; right_u: (H, W) uint16, steps; out: (W,) uint8.
    """
    height, width = label.shape
    out[:] = _NO
    if i < REACH or i >= height - REACH:
        return
    here, inner = label[i], out[REACH : width - REACH]
    for a in range(-REACH, REACH + 1):
        for b in range(5):
            other = label[i + a, b : b + width - 2 * REACH]
            k = here[REACH : width - REACH]
            for j in range(inner.shape[0]):
                inner[j] |= np.uint8(other[j] != k[j])
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


@serial
def pixels_of_band(label: Any, right_u: Any, band: int, at: Any) -> int:
    """Border pixels of a band into ``at`` (ROWS W + 1, 2) int32, rows and columns; their number."""
    height, width = label.shape
    border = np.empty(width, np.uint8)
    n = 0
    for i in range(band * ROWS, min((band + 1) * ROWS, height)):
        border_of_row(label, right_u, i, border)
        for j in range(width):
            at[n, 0], at[n, 1] = i, j
            n += border[j]
    return n


@serial
def distance_right(label: Any, right_u: Any, j: int) -> Any:
    """Distance to the border along the row in the right image, in :data:`RIGHT_STEPS`, at most 2."""
    k, width, least = label[j], label.shape[0], 2 * RIGHT_STEPS
    for step in (-1, 1):
        at = j
        for _ in range(FARTHEST):
            if at + step < 0 or at + step >= width or label[at + step] != k:
                least = min(least, int(abs(np.int32(right_u[at]) - np.int32(right_u[j]))))
                break
            at += step
    return np.float32(least) * np.float32(1 / RIGHT_STEPS)
