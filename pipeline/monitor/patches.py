"""Smooth surface patches and their measurement in the raw images (compiled).

A patch is a rectangle of left pixels about two fringe periods wide. Its points (the cloud's) are projected into the
projector and into the right camera; the projector's phase there, and the right pixels, are fitted by quadratic
polynomials, which average out the noise of single points and ripple within a period. Then
the light (:mod:`pipeline.monitor.lock_in`) and the texture (:mod:`pipeline.monitor.brightness`) are measured on it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import allocating, project
from pipeline.common.parallel_for import parallel_allocating
from pipeline.monitor.brightness import EDGE, brightness, compare
from pipeline.monitor.lock_in import lock_in
from pipeline.monitor.polynomial import QUADRATIC, fit_quadratic, quadratic

SHAPE = 14
"""Numbers of a patch's shape; see :func:`measure_patches`."""
GROUP = 4
"""Patches that one thread measures together."""
_LEAST_VALID = 0.85
_LARGEST_ROUGHNESS = 0.2  # rad rms about the polynomial


@allocating
def measure_patches(
    left: Any, right: Any, mosaic: Any, black: Any, xyz: Any, origins: Any, columns: int, rows: int, projector: Any,
    other: Any, phases: Any, first: int, clip: int, good: Any, shape: Any, light: Any, texture: Any,
) -> None:  # fmt: skip
    """Measure all patches.

    Args:
        left, right: (H, W, 3) or, for a mosaic, (H, W, 1) uint8; mosaic: (2, 2) channel numbers.
        black: (2, 3) counts, left and right; xyz: (H, W, 3) float32, valid at least at pixels with even coordinates.
        origins: (n, 2) even column and row of each patch's first pixel; columns, rows: its size.
        projector, other: packed models; phases: (m,) phase at every projector coordinate.
        first: 0 when it grows along u, else 1.
        clip: counts from which a sample is saturated.
        good: (n,) uint8, bit 1: shape and light are valid, bit 2: texture too.
        shape: (n, 14): point x, y, z of the middle; roughness, rad; right pixel u, v; phase slopes of the left image
            along u and v, of the right one along u and v, rad per pixel; phase per projector coordinate, rad per pixel;
            projector coordinate; fraction of valid points; rms of the texture's difference.
        light: (n, 2, 3, 3) camera, channel, (a, p, q), raw counts.
        texture: (n, 8), see :data:`pipeline.monitor.brightness.TEXTURE`.
    """
    height, width = xyz.shape[:2]
    other_height, other_width = right.shape[:2]
    step_u, step_v = 2, 4
    most = ((columns + step_u - 1) // step_u) * ((rows + step_v - 1) // step_v)
    points = np.empty((most, 5))
    matrix, b = np.empty((QUADRATIC, QUADRATIC)), np.empty((QUADRATIC, 3))
    q, q_right = np.empty((QUADRATIC, 3)), np.empty((QUADRATIC, 1))
    targets, single = np.array([2, 3, 4]), np.array([2])
    half_u, half_v = 0.5 * columns, 0.5 * rows
    wide, high = 3 * columns + 8, 2 * rows + 8
    scratch, raw = np.empty((5, wide), np.float32), np.empty((2, high, wide), np.float32)
    bright_left, bright_right = np.empty((high, wide), np.float32), np.empty((high, wide), np.float32)
    for k in range(origins.shape[0]):
        good[k] = 0
        u0, v0 = origins[k, 0], origins[k, 1]
        if u0 < EDGE or v0 < EDGE or u0 + columns + EDGE > width or v0 + rows + EDGE > height:
            continue
        centre_u, centre_v = u0 + 0.5 * (columns - 1), v0 + 0.5 * (rows - 1)
        n, px, py, pz, pc = np.int64(0), 0.0, 0.0, 0.0, 0.0
        for v in range(v0, v0 + rows, step_v):
            for u in range(u0, u0 + columns, step_u):
                z = float(xyz[v, u, 2])
                if not np.isfinite(z):
                    continue
                x, y = float(xyz[v, u, 0]), float(xyz[v, u, 1])
                sent = project(projector, x, y, z)
                shift = project(other, x, y, z)
                column = sent[0] if first == 0 else sent[1]
                c = min(max(int(np.floor(column)), 0), phases.shape[0] - 2)
                points[n, 0], points[n, 1] = u, v
                points[n, 2] = phases[c] + (column - c) * (phases[c + 1] - phases[c])
                points[n, 3], points[n, 4] = shift
                n, px, py, pz, pc = n + 1, px + x, py + y, pz + z, pc + column
        shape[k, 12] = n / most
        if n < _LEAST_VALID * most:
            continue
        if not fit_quadratic(points, n, np.int64(0), centre_u, centre_v, half_u, half_v, targets, matrix, q):
            continue
        rough = 0.0
        for i in range(n):
            d = points[i, 2] - quadratic(q, 0, (points[i, 0] - centre_u) / half_u, (points[i, 1] - centre_v) / half_v)
            rough += d * d
        rough = np.sqrt(rough / n)
        right_u, right_v = q[0, 1], q[0, 2]
        half_right_u, half_right_v = abs(q[1, 1]), abs(q[2, 2])
        if not rough < _LARGEST_ROUGHNESS:
            continue
        if not (0.5 * half_u < half_right_u < 2.0 * half_u and 0.7 * half_v < half_right_v < 1.4 * half_v):
            continue
        if not fit_quadratic(
            points, n, np.int64(3), right_u, right_v, half_right_u, half_right_v, single, matrix, q_right
        ):
            continue
        left_r, top_r = int(np.ceil(right_u - half_right_u)), int(np.ceil(right_v - half_right_v))
        columns_r, rows_r = int(2 * half_right_u), int(2 * half_right_v)
        if left_r < 0 or top_r < 0 or left_r + columns_r > other_width or top_r + rows_r > other_height:
            continue
        if not lock_in(left, mosaic, v0, u0, rows, columns, q, centre_u, centre_v, half_u, half_v, clip, scratch,
                        matrix, b, light[k, 0]):  # fmt: skip
            continue
        if not lock_in(right, mosaic, top_r, left_r, rows_r, columns_r, q_right, right_u, right_v, half_right_u,
                        half_right_v, clip, scratch, matrix, b, light[k, 1]):  # fmt: skip
            continue
        c = min(max(int(np.floor(pc / n)), 0), phases.shape[0] - 2)
        shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 3] = px / n, py / n, pz / n, rough
        shape[k, 4], shape[k, 5] = right_u, right_v
        shape[k, 6], shape[k, 7] = q[1, 0] / half_u, q[2, 0] / half_v
        shape[k, 8], shape[k, 9] = q_right[1, 0] / half_right_u, q_right[2, 0] / half_right_v
        shape[k, 10], shape[k, 11], shape[k, 13] = phases[c + 1] - phases[c], pc / n, 0.0
        good[k] = 1
        extra = EDGE + 3
        origin_u, origin_v = left_r - extra, top_r - extra
        w, h = min(columns_r + 2 * extra, wide), min(rows_r + 2 * extra, high)
        if origin_u < 0 or origin_v < 0 or origin_u + w > other_width or origin_v + h > other_height:
            continue
        brightness(left, mosaic, black[0], v0 - EDGE, u0 - EDGE, rows + 2 * EDGE, columns + 2 * EDGE, q, centre_u,
                    centre_v, half_u, half_v, light[k, 0], scratch, raw, bright_left)  # fmt: skip
        brightness(right, mosaic, black[1], origin_v, origin_u, h, w, q_right, right_u, right_v, half_right_u,
                    half_right_v, light[k, 1], scratch, raw, bright_right)  # fmt: skip
        if compare(bright_left, bright_right, rows, columns, q, half_u, half_v, float(origin_u), float(origin_v), h, w,
                    texture[k]):  # fmt: skip
            good[k] = 3
            shape[k, 13] = np.sqrt(max(texture[k, 6], 0.0) / (rows * ((columns - 1) // 2)))


@parallel_allocating
def measure_group(
    group: int, left: Any, right: Any, mosaic: Any, black: Any, xyz: Any, origins: Any, columns: int, rows: int,
    projector: Any, other: Any, phases: Any, first: int, clip: int, good: Any, shape: Any, light: Any, texture: Any,
) -> None:  # fmt: skip
    """:func:`measure_patches` of :data:`GROUP` patches, on numba's threads; the same arguments, for all patches."""
    start, end = group * GROUP, min(group * GROUP + GROUP, origins.shape[0])
    measure_patches(
        left, right, mosaic, black, xyz, origins[start:end], columns, rows, projector, other, phases, first, clip,
        good[start:end], shape[start:end], light[start:end], texture[start:end],
    )  # fmt: skip
