"""Projector light on surfaces: blur, colour shift, distance, angle and albedo, in compiled code."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import unowned
from sim.render.lens import pixel_of
from sim.rig.optics import Optics
from sim.scene.jit import compiled, inline
from sim.scene.ray_intersection import Table
from sim.scene.texture import albedo

Array = NDArray[np.float64]

# Pixels are interpolated by quadratic B-splines instead of squares; the splines' own blur counts as defocus.
_SPLINE_VARIANCE = 1 / 6


def projected_light(image: NDArray[np.uint8], optics: Optics) -> NDArray[np.float32]:
    """Light of an image after response and blur, (H, W, 3), 0..255, to be sampled by :func:`shade`."""
    light = optics.light_of(image)
    variance = optics.defocus_px**2 - _SPLINE_VARIANCE
    if variance > 0.01:
        blur = cv2.GaussianBlur(light, (0, 0), float(np.sqrt(variance)), borderType=cv2.BORDER_REPLICATE)
        light = np.asarray(blur, dtype=np.float32)
    return np.ascontiguousarray(light, dtype=np.float32)


@inline
def _spline(f: float) -> tuple[float, float, float]:
    """Weights of three neighbours at an offset of -0.5..0.5 from the middle one."""
    return 0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2


@inline
def _sample(light: NDArray[np.float32], u: float, v: float, channel: int) -> float:
    """Light of one channel at a position in the projector image; 0 outside."""
    rows, columns = light.shape[0], light.shape[1]
    if u < -0.5 or v < -0.5 or u > columns - 0.5 or v > rows - 0.5:
        return 0.0
    j, i = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    wu, wv = _spline(u - j), _spline(v - i)
    total = 0.0
    for a in range(3):
        row = min(max(i + a - 1, 0), rows - 1)
        line = 0.0
        for b in range(3):
            column = min(max(j + b - 1, 0), columns - 1)
            line += wu[b] * light[row, column, channel]
        total += wv[a] * line
    return total


@compiled
def shade(
    s: Table,
    points: Array,
    normals: Array,
    which: NDArray[np.int64],
    lit: NDArray[np.bool_],
    projector: Array,
    light: NDArray[np.float32],
    shift: Array,
    standoff_mm: float,
    ambient: float,
) -> NDArray[np.float32]:
    """Light reflected by surface points, (n, 3), 0..255; 0 without a hit."""
    s, projector, light = unowned(s), unowned(projector), unowned(light)
    out = np.zeros((len(points), 3), np.float32)
    for k in range(len(points)):
        i = which[k]
        if i < 0:
            continue
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        cx, cy, cz = x - s.translation[i, 0], y - s.translation[i, 1], z - s.translation[i, 2]
        r = s.rotation[i]
        color = albedo(
            s.base[i],
            s.texture[i],
            r[0, 0] * cx + r[1, 0] * cy + r[2, 0] * cz,
            r[0, 1] * cx + r[1, 1] * cy + r[2, 1] * cz,
            r[0, 2] * cx + r[1, 2] * cy + r[2, 2] * cz,
        )
        strength, u, v = 0.0, 0.0, 0.0
        if lit[k]:
            u, v, _ = pixel_of(projector, x, y, z)
            px, py, pz = projector[22] - x, projector[23] - y, projector[24] - z
            d2 = px * px + py * py + pz * pz
            cosine = (px * normals[k, 0] + py * normals[k, 1] + pz * normals[k, 2]) / np.sqrt(d2)
            strength = max(cosine, 0.0) * standoff_mm * standoff_mm / d2
        for c in range(3):
            direct = strength * _sample(light, u - shift[c], v, c) if strength > 0 else 0.0
            out[k, c] = color[c] * (direct + 255 * ambient)
    return out
