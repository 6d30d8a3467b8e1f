"""Coloured textures: smooth stains and fine speckle, different in every channel, fixed to the shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.scene.jit import inline

Array = NDArray[np.float64]


@inline
def _hash(x: int, y: int, z: int, seed: int) -> int:
    """Hash of a lattice point, 30 bits."""
    h = np.uint64(x & 0xFFFFFFFF) * np.uint64(0x9E3779B1) + np.uint64(y & 0xFFFFFFFF) * np.uint64(0x85EBCA77)
    h += np.uint64(z & 0xFFFFFFFF) * np.uint64(0xC2B2AE3D) + np.uint64(seed & 0xFFFFFFFF) * np.uint64(0x27D4EB2F)
    h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    h ^= h >> np.uint64(32)
    h *= np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return int(h & np.uint64(0x3FFFFFFF))


@inline
def _fade(f: float) -> float:
    return f * f * f * (f * (6 * f - 15) + 10)


@inline
def noise(x: float, y: float, z: float, seed: int) -> tuple[float, float, float]:
    """Three independent smooth random functions of a position, each -1..1, with a grain of one unit."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    fx, fy, fz = _fade(x - i), _fade(y - j), _fade(z - k)
    red, green, blue = 0.0, 0.0, 0.0
    for corner in range(8):
        a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if c else 1 - fz)
        h = _hash(i + a, j + b, k + c, seed)
        red += weight * (h & 1023)
        green += weight * ((h >> 10) & 1023)
        blue += weight * ((h >> 20) & 1023)
    return red / 511.5 - 1, green / 511.5 - 1, blue / 511.5 - 1


@inline
def albedo(base: Array, texture: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Albedo R G B at a position on the shape, mm.

    ``texture``: amplitude of the smooth stains, their grain in mm, the same two of the speckle, and the seed.
    """
    r, g, b = 1.0, 1.0, 1.0
    seed = int(texture[4])
    if texture[0] > 0:
        dr, dg, db = noise(x / texture[1], y / texture[1], z / texture[1], seed)
        r, g, b = r + texture[0] * dr, g + texture[0] * dg, b + texture[0] * db
    if texture[2] > 0:
        dr, dg, db = noise(x / texture[3], y / texture[3], z / texture[3], seed + 1)
        r, g, b = r + texture[2] * dr, g + texture[2] * dg, b + texture[2] * db
    return (
        min(max(base[0] * r, 0.02), 0.98),
        min(max(base[1] * g, 0.02), 0.98),
        min(max(base[2] * b, 0.02), 0.98),
    )
