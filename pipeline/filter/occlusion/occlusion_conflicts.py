"""Occlusion conflicts: two surfaces claim the same pixel of another device, and one of them is rejected there."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import allocating, linked
from pipeline.common.parallel_for import parallel_allocating
from pipeline.match.match_result import PIXEL_STEPS

TILE_ROWS, TILE_COLUMNS = 8, 16
"""Pixels of the left image's tiles."""
PARAMETER_STEPS = 16384
"""Steps of the parameter s from 0 to 1."""


class Values(NamedTuple):
    """The quantity that must agree among points on the same pixel: the absolute phase, or else the depth.

    Args:
        phase: (H, W) int16, absolute phase modulo 16 bits.
        by_depth: whether the parameter s counts instead, 1/z = base + span s, in :data:`PARAMETER_STEPS`.
    """

    phase: NDArray[np.int16]
    by_depth: bool
    base: np.float32
    span: np.float32


class Claims(NamedTuple):
    """Claims to pixels of blocks that several surfaces claim, (PARTS, n), by bands of rows.

    Args:
        entries: (PARTS) int32, number of claims of each band.
        pixel: flat index; place: claimed pixel, 64 to a shared block; surface of the pixel.
        depth: mm; value: of :class:`Values`; conflict: bits, 1 with the nearest claim, 2 with the farthest.
    """

    entries: NDArray[np.int32]
    pixel: NDArray[np.int32]
    place: NDArray[np.int32]
    surface: NDArray[np.int32]
    depth: NDArray[np.float32]
    value: NDArray[np.int16]
    conflict: NDArray[np.uint8]

    @staticmethod
    def empty(parts: int, most: int) -> Claims:
        """Space for so many claims in each band."""
        types = (np.int32, np.int32, np.int32, np.float32, np.int16, np.uint8)
        return Claims(np.zeros(parts, np.int32), *(np.empty((parts, most), t) for t in types))


@linked
def _any_shared(number: Any, box: Any, across: int) -> bool:
    for y in range(box[2], box[3] + 1):
        for x in range(box[0], box[1] + 1):
            if number[y * across + x] >= 0:
                return True
    return False


@parallel_allocating
def list_claims(
    part: int, valid: Any, label: Any, u: Any, v: Any, depth: Any, values: Any, width: int, height: int, box: Any,
    number: Any, entries: Any, pixels: Any, places: Any, surfaces: Any, depths: Any, all_values: Any,
) -> None:  # fmt: skip
    """List the pixels that claim shared blocks, by bands of rows.

    Args:
        valid: (H, W) uint8; label: (H, W) uint16, one more than the surface; depth: (H, W) mm.
        u, v: (H, W) uint16, pixel in the other device of this width and height; values: :class:`Values`.
        box, number: of :mod:`pipeline.filter.occlusion.uniqueness`.
        entries, pixels, places, surfaces, depths, all_values: the arrays of :class:`Claims`, written.
    """
    rows, columns = valid.shape
    down, tiles = box.shape[:2]
    parts = entries.shape[0]
    across = (width + 7) // 8
    shared_tiles = np.empty(tiles, np.int32)
    n = 0
    for band in range(part * down // parts, (part + 1) * down // parts):
        found = 0
        for tile in range(tiles):
            if _any_shared(number, box[band, tile], across):
                shared_tiles[found], found = tile, found + 1
        # Row by row: memory is read ahead along rows.
        for i in range(TILE_ROWS * band, min(TILE_ROWS * (band + 1), rows)):
            for m in range(found):
                first = TILE_COLUMNS * shared_tiles[m]
                for j in range(first, min(first + TILE_COLUMNS, columns)):
                    a, b = np.int32(u[i, j]) // PIXEL_STEPS, np.int32(v[i, j]) // PIXEL_STEPS
                    x, y = a // 8, b // 8
                    inside = (valid[i, j] != 0) & (a < width) & (b < height)
                    k = number[y * across + x if inside else 0]
                    if k < 0 or not inside:
                        continue
                    pixels[part, n] = i * columns + j
                    places[part, n] = k * 64 + (b & 7) * 8 + (a & 7)
                    surfaces[part, n], depths[part, n] = np.int32(label[i, j]) - 1, depth[i, j]
                    if values.by_depth:
                        s = (np.float32(1.0) / depth[i, j] - values.base) / values.span
                        all_values[part, n] = np.int16(np.int32(s * np.float32(PARAMETER_STEPS)))
                    else:
                        all_values[part, n] = values.phase[i, j]
                    n += 1
    entries[part] = n


@allocating
def nearest_and_farthest(entries: Any, places: Any, depth: Any, near: Any, far: Any) -> None:
    """Entry with the least and with the largest depth at each claimed place, -1 none (flat indices)."""
    near[:] = -1
    capacity = places.shape[1]
    depths = depth.ravel()
    for part in range(entries.shape[0]):
        for n in range(entries[part]):
            c, e = places[part, n], part * capacity + n
            if near[c] < 0:
                near[c] = far[c] = e
            elif depths[e] < depths[near[c]]:
                near[c] = e
            elif depths[e] > depths[far[c]]:
                far[c] = e


@linked
def _differ(surface: Any, value: Any, e: int, other: int, tolerance: int) -> bool:
    return bool(surface[e] != surface[other] and abs(np.int64(np.int16(value[e] - value[other]))) > tolerance)


@parallel_allocating
def find_conflicts(
    part: int, entries: Any, places: Any, surface: Any, value: Any, near: Any, far: Any, tolerance: int, conflicts: Any,
    against: Any,
) -> None:  # fmt: skip
    """Find the claims in conflict with another surface, and their number by surface.

    Args:
        entries, places, surface, value: of :class:`Claims`; conflicts: likewise, written.
        near, far: of :func:`nearest_and_farthest`; tolerance: steps of the values up to which claimants agree.
        against: (PARTS, surfaces) int32, zero before.
    """
    capacity = places.shape[1]
    surfaces, values = surface.ravel(), value.ravel()
    for n in range(entries[part]):
        a, b = near[places[part, n]], far[places[part, n]]
        e = part * capacity + n
        bits = 0
        if a != b:
            bits = (1 if _differ(surfaces, values, e, a, tolerance) else 0) | (
                2 if _differ(surfaces, values, e, b, tolerance) else 0
            )
        conflicts[part, n] = bits
        if bits != 0:
            against[part, surfaces[e]] += 1


@linked
def _keeps_pixel(label: int, depth: float, other: int, other_depth: float, size: Any, share: Any, sure: int) -> bool:
    """Whether a claim keeps its pixel against another one.

    A false surface has conflicts nearly everywhere, a real one only where another one occludes it; of two established
    real surfaces the nearer occludes the other; of small ones the larger is kept.
    """
    a, b = share[label], share[other]
    if max(a, b) > 0.4 and abs(a - b) > 0.25:
        return a < b
    if size[label] >= sure and size[other] >= sure:
        return depth < other_depth
    return size[label] > size[other]


@parallel_allocating
def arbitrate(
    part: int, entries: Any, pixels: Any, places: Any, surface: Any, depth: Any, conflicts: Any, near: Any, far: Any,
    size: Any, share: Any, sure: int, valid: Any,
) -> None:  # fmt: skip
    """Reject the points of claims that lose their pixel; ``valid`` (flat) is changed.

    Args:
        entries, pixels, places, surface, depth, conflicts: of :class:`Claims`; near, far: of
            :func:`nearest_and_farthest`.
        size: pixels of each surface; share: float32, share of them in conflict with another surface.
        sure: size from which a surface is taken as established.
    """
    capacity = places.shape[1]
    surfaces, depths = surface.ravel(), depth.ravel()
    for n in range(entries[part]):
        bits = conflicts[part, n]
        if bits == 0:
            continue
        a, b = near[places[part, n]], far[places[part, n]]
        e = part * capacity + n
        mine, z = surfaces[e], depths[e]
        kept = (bits & 1) == 0 or _keeps_pixel(mine, z, surfaces[a], depths[a], size, share, sure)
        kept = kept and ((bits & 2) == 0 or _keeps_pixel(mine, z, surfaces[b], depths[b], size, share, sure))
        if not kept:
            valid[pixels[part, n]] = 0
