"""Which of two surfaces keeps a pixel of another device that both claim."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange, serial

_HALF = np.float32(0.5)
_TWO_PI = np.float32(2 * pi)


@parallel
def list_claims(
    label: Any, u: Any, v: Any, depth: Any, start: Any, cell: Any, count: Any, number: Any,
    entries: Any, pixel: Any, place: Any, surface: Any, far_off: Any,
) -> None:  # fmt: skip
    """List the pixels that claim shared blocks, in scanning order, by bands of rows.

    Args:
        label: (H, W) int32; u, v: (H, W) pixel in the other device; depth: (H, W) mm.
        start, cell, count, number: of :mod:`pipeline.uniqueness`.
        entries: (PARTS) int32, becomes the length of each band's list.
        pixel, place, surface, far_off: (PARTS, n), become flat index, claimed place (64 to a shared block), surface and
            depth of the entries.
    """
    rows, columns = label.shape
    parts = entries.shape[0]
    for part in prange(parts):
        n = 0
        for i in range(part * rows // parts, (part + 1) * rows // parts):
            for t in range(count[i]):
                b = cell[i, t]
                if b < 0 or number[b] < 0:
                    continue
                for j in range(start[i, t], start[i, t + 1]):
                    x, y = np.int32(u[i, j] + _HALF), np.int32(v[i, j] + _HALF)
                    pixel[part, n] = i * columns + j
                    place[part, n] = number[b] * 64 + (y & 7) * 8 + (x & 7)
                    surface[part, n], far_off[part, n] = label[i, j], depth[i, j]
                    n += 1
        entries[part] = n


@parallel
def absolute_phases(entries: Any, pixel: Any, phase: Any, order: Any, out: Any) -> None:
    """Absolute phase of the listed pixels; phase and order flat."""
    for part in prange(entries.shape[0]):
        for e in range(entries[part]):
            k = pixel[part, e]
            out[part, e] = phase[k] + _TWO_PI * np.float32(order[k])


@parallel
def parameters(entries: Any, depth: Any, base: Any, span: Any, out: Any) -> None:
    """Parameter s of the listed depths on their rays, 1/z = base + span s; all float32."""
    for part in prange(entries.shape[0]):
        for e in range(entries[part]):
            out[part, e] = (np.float32(1.0) / depth[part, e] - base) / span


@serial
def _prevails(label: int, depth: float, rival: int, rival_depth: float, size: Any, share: Any, sure: int) -> bool:
    """Whether a claim beats its rival.

    A ghost is contested nearly everywhere, a real surface only where another one hides it; of two established real
    surfaces the nearer hides the other; of small ones the larger is believed.
    """
    a, b = share[label], share[rival]
    if max(a, b) > 0.4 and abs(a - b) > 0.25:
        return a < b
    if size[label] >= sure and size[rival] >= sure:
        return depth < rival_depth
    return size[label] > size[rival]


@serial
def nearest_and_farthest(entries: Any, place: Any, depth: Any, near: Any, far: Any) -> None:
    """Entry with the least and with the largest depth at each claimed place, -1 none (flat indices)."""
    near[:] = -1
    capacity = place.shape[1]
    places, depths = place.ravel(), depth.ravel()
    for part in range(entries.shape[0]):
        for e in range(part * capacity, part * capacity + entries[part]):
            c = places[e]
            if near[c] < 0:
                near[c] = far[c] = e
            elif depths[e] < depths[near[c]]:
                near[c] = e
            elif depths[e] > depths[far[c]]:
                far[c] = e


@serial
def arbitrate(
    entries: Any, pixel: Any, place: Any, surface: Any, depth: Any, value: Any, near: Any, far: Any, size: Any,
    tolerance: Any, sure: int, known: Any,
) -> int:  # fmt: skip
    """Forget the entries whose claim does not prevail; ``known`` (flat) is changed. Returns their number."""
    capacity = place.shape[1]
    places, depths, values, labels, pixels = (place.ravel(), depth.ravel(), value.ravel(), surface.ravel(),
                                              pixel.ravel())  # fmt: skip
    # Share of each surface's points whose place another surface claims as well.
    surfaces = size.shape[0]
    share = np.zeros(surfaces, np.float32)
    for part in range(entries.shape[0]):
        for e in range(part * capacity, part * capacity + entries[part]):
            c = places[e]
            for rival in (near[c], far[c]):
                if labels[rival] != labels[e] and abs(values[rival] - values[e]) > tolerance:
                    share[labels[e]] += 1
                    break
    for k in range(surfaces):
        share[k] /= size[k]
    gone = 0
    for part in range(entries.shape[0]):
        for e in range(part * capacity, part * capacity + entries[part]):
            c, mine = places[e], labels[e]
            if near[c] == far[c]:
                continue
            for rival in (near[c], far[c]):
                if labels[rival] == mine or abs(values[rival] - values[e]) <= tolerance:
                    continue
                if not _prevails(mine, depths[e], labels[rival], depths[rival], size, share, sure):
                    known[pixels[e]] = 0
                    gone += 1
                    break
    return gone
