"""Surface normals of an organised cloud, by a weighted fit of a plane around every point.

Around a pixel the position is fitted by ``p(u, v) = p0 + pu u + pv v`` over a window of 7 x 7 pixels (u to the right, v
down), weighted by 1 / sigma^2. The normal is ``pv x pu``, which points towards the camera because it sees the surface's
front, whatever rigid frame the points are in. Its direction needs no solution of the normal equations: the sum of
``w (u - mean of the row) p`` is a multiple of ``pu``, and that of ``w (v - mean) p`` a multiple of ``pv`` and some of
``pu``, which does not change the direction of the cross product.

Only pixels of the same surface take part: along the window's middle column, and from there along each row, pixels
follow each other until the position jumps, or until its second difference exceeds its noise (an edge between faces).
The sums are therefore separable: along the rows first, then over them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.attributes.plane_fit import ROWS, TILE, fit_normals
from pipeline.common.parallel_for import blocks

F32 = NDArray[np.float32]

_STEEPEST = 8.0
"""Neighbours on one surface are at most so many times the median distance of neighbours apart."""
_CURVED_SQ = np.float32(0.2**2)
"""Second difference that a curved surface without noise may have, squared, in median distances."""


def normals_of(xyz: F32, sigma_mm: F32, *, stride: int = 1) -> F32:
    """Unit normals towards the camera, (H, W, 3) float32; NaN where there is no point, or too few around it.

    Args:
        xyz: (H, W, 3) mm, on the camera's pixel grid, NaN where invalid, in any rigid frame.
        sigma_mm: (H, W), one standard deviation.
        stride: spacing of the rows and columns that hold points; the others are NaN.
    """
    points, sigma = (np.ascontiguousarray(plane[::stride, ::stride]) for plane in (xyz, sigma_mm))
    # Kernels are compiled for read-only arrays too if they are given any.
    out = np.empty_like(points)
    height, width = sigma.shape
    pitch = np.float32(pitch_mm(points))
    tiles = blocks(width, TILE)
    fit_normals(
        blocks(height, ROWS) * tiles, _writable(points).reshape(-1), _writable(sigma), tiles,
        np.float32(_mean(points[..., 2])), np.float32(_mean(sigma) ** 2),
        np.float32((_STEEPEST * pitch) ** 2), _CURVED_SQ * pitch * pitch, out.reshape(-1),
    )  # fmt: skip
    if stride == 1:
        return out
    whole = np.full_like(xyz, np.nan)
    whole[::stride, ::stride] = out
    return whole


def pitch_mm(xyz: F32) -> float:
    """Median distance of neighbours in some of the rows, in all if these have none, (H, W, 3) -> mm; 0 without any."""
    for step in (max(1, len(xyz) // 8), 1):
        steps = np.diff(xyz[::step], axis=1)
        apart = np.sqrt(np.einsum("...k,...k", steps, steps))
        apart = apart[np.isfinite(apart)]
        if len(apart):
            return float(np.median(apart))
    return 0.0


def _writable(array: F32) -> F32:
    """The array, copied if it is read-only: numba would compile the kernel once more for it."""
    return array if array.flags.writeable else array.copy()


def _mean(plane: F32) -> float:
    """Approximate mean of the known values of an (H, W) plane; 1 without any."""
    for step in (16, 1):
        values = plane[::step, ::step]
        known = values[np.isfinite(values)]
        if len(known):
            return float(known.mean())
    return 1.0
