"""Exact intersection of rays with the analytic shapes, in compiled code.

Rays are transformed into each shape's frame; ``dims`` as in :mod:`sim.scene.shapes`. A miss is ``inf``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import unowned
from sim.scene.jit import compiled, inline

Array = NDArray[np.float64]
Hit = tuple[float, float, float, float]

RECTANGLE, SPHERE, BOX, CYLINDER, RELIEF, MESH = range(6)
_NEAR_MM = 1e-7
_OFFSET_MM = 1e-3
_SHADOW_STEP_MM = 0.05
_INF = np.inf


class Table(NamedTuple):
    """All shapes of a scene at one instant: kinds (n,), poses, sizes, bounding radii, colours and textures."""

    kind: NDArray[np.int64]
    rotation: Array
    translation: Array
    dims: Array
    radius: Array
    base: Array
    texture: Array


@inline
def _bump(exponent: float) -> float:
    """``exp(-exponent)``, or 0 where that is negligible."""
    return np.exp(-exponent) if exponent < 20 else 0.0


@compiled
def relief_height(variant: float, p: float, q: float) -> float:
    """Height of a relief over its ellipse, as a share of its depth; (p, q) = (x/a, y/b), q grows downwards."""
    r2 = p * p + q * q
    if r2 >= 1:
        return 0.0
    rim = 1 - r2
    if variant == 1:
        waves = np.sin(4.1 * p + 0.4) * np.cos(3.3 * q) + 0.5 * np.sin(7.3 * p * q + 2.1 * q)
        return rim * (0.75 + 0.25 * waves)
    s = abs(p)
    h = 0.34 * _bump((p / 0.13) ** 2 + ((q - 0.10) / 0.22) ** 2)
    h += 0.10 * _bump((p / 0.17) ** 2 + ((q - 0.24) / 0.08) ** 2)
    h -= 0.20 * _bump(((s - 0.36) / 0.17) ** 2 + ((q + 0.2) / 0.13) ** 2)
    h += 0.10 * _bump(((s - 0.36) ** 2 + (q + 0.2) ** 2) / 0.009)
    h += 0.08 * _bump((p / 0.5) ** 2 + ((q + 0.40) / 0.09) ** 2)
    h += 0.09 * _bump((p / 0.24) ** 2 + ((q - 0.50) / 0.05) ** 2)
    h += 0.10 * _bump((p / 0.20) ** 2 + ((q - 0.62) / 0.05) ** 2)
    h += 0.13 * _bump((p / 0.25) ** 2 + ((q - 0.80) / 0.10) ** 2)
    h += 0.07 * _bump(((s - 0.5) / 0.2) ** 2 + ((q - 0.15) / 0.2) ** 2)
    return rim * (1 + 0.65 * r2 + h)


@compiled
def relief_heights(variant: float, p: Array, q: Array) -> Array:
    """:func:`relief_height` at the places of two tables, without a call from Python for each."""
    out = np.empty_like(p)
    for row in range(p.shape[0]):
        for column in range(p.shape[1]):
            out[row, column] = relief_height(variant, p[row, column], q[row, column])
    return out


@inline
def _rectangle(m: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Hit:
    if abs(dz) < 1e-12:
        return _INF, 0.0, 0.0, 0.0
    t = -oz / dz
    if t <= _NEAR_MM or abs(ox + t * dx) > m[0] or abs(oy + t * dy) > m[1]:
        return _INF, 0.0, 0.0, 0.0
    return t, 0.0, 0.0, -1.0 if dz > 0 else 1.0


@inline
def _sphere(m: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Hit:
    b = ox * dx + oy * dy + oz * dz
    # The distance of the ray to the centre, without the cancellation of b^2 - c.
    px, py, pz = ox - b * dx, oy - b * dy, oz - b * dz
    discriminant = m[0] * m[0] - (px * px + py * py + pz * pz)
    if discriminant < 0:
        return _INF, 0.0, 0.0, 0.0
    root = np.sqrt(discriminant)
    t = -b - root
    if t <= _NEAR_MM:
        t = -b + root
    if t <= _NEAR_MM:
        return _INF, 0.0, 0.0, 0.0
    return t, (ox + t * dx) / m[0], (oy + t * dy) / m[0], (oz + t * dz) / m[0]


@inline
def _slab(o: float, d: float, half: float) -> tuple[float, float]:
    if abs(d) < 1e-12:
        return (-_INF, _INF) if abs(o) <= half else (_INF, -_INF)
    a, b = (-half - o) / d, (half - o) / d
    return (a, b) if a < b else (b, a)


@inline
def _box(m: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Hit:
    ax, bx = _slab(ox, dx, m[0])
    ay, by = _slab(oy, dy, m[1])
    az, bz = _slab(oz, dz, m[2])
    near, far = max(ax, ay, az), min(bx, by, bz)
    if near > far or near <= _NEAR_MM:
        return _INF, 0.0, 0.0, 0.0
    if near == ax:
        return near, -np.sign(dx), 0.0, 0.0
    if near == ay:
        return near, 0.0, -np.sign(dy), 0.0
    return near, 0.0, 0.0, -np.sign(dz)


@inline
def _cylinder(m: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Hit:
    a = dx * dx + dz * dz
    top, bottom = _slab(oy, dy, m[1])
    enter, leave = -_INF, _INF
    if a > 1e-15:
        b = (ox * dx + oz * dz) / a
        px, pz = ox - b * dx, oz - b * dz
        discriminant = m[0] * m[0] - (px * px + pz * pz)
        if discriminant < 0:
            return _INF, 0.0, 0.0, 0.0
        root = np.sqrt(discriminant / a)
        enter, leave = -b - root, -b + root
    elif ox * ox + oz * oz > m[0] * m[0]:
        return _INF, 0.0, 0.0, 0.0
    near, far = max(enter, top), min(leave, bottom)
    if near > far or near <= _NEAR_MM:
        return _INF, 0.0, 0.0, 0.0
    if near == top:
        return near, 0.0, -np.sign(dy), 0.0
    return near, (ox + near * dx) / m[0], 0.0, (oz + near * dz) / m[0]


@inline
def _ellipse_span(m: Array, ox: float, oy: float, dx: float, dy: float) -> tuple[float, float]:
    """Where a ray is inside the elliptic cylinder |(x/a, y/b)| < 1."""
    px, py, ex, ey = ox / m[0], oy / m[1], dx / m[0], dy / m[1]
    a, b, c = ex * ex + ey * ey, px * ex + py * ey, px * px + py * py - 1
    if a < 1e-18:
        return (-_INF, _INF) if c < 0 else (_INF, -_INF)
    discriminant = b * b - a * c
    if discriminant < 0:
        return _INF, -_INF
    root = np.sqrt(discriminant)
    return (-b - root) / a, (-b + root) / a


@compiled
def _relief(m: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, floor: float) -> Hit:
    """The solid between z = 0 and z = -depth h(x/a, y/b); dims: a, b, depth, variant, steepest slope, highest point.

    ``floor`` is the least step in mm; shadows afford larger ones than images.
    """
    half = m[5] / 2
    near, far = _slab(oz + half, dz, half)
    inside, outside = _ellipse_span(m, ox, oy, dx, dy)
    t, end = max(near, inside, _NEAR_MM), min(far, outside)
    fall = abs(dz) + m[4] * np.sqrt(dx * dx + dy * dy)
    first, last_t, last_gap = True, 0.0, 0.0
    for _ in range(400):
        if t > end:
            return _INF, 0.0, 0.0, 0.0
        x, y = ox + t * dx, oy + t * dy
        gap = -(oz + t * dz) - m[2] * relief_height(m[3], x / m[0], y / m[1])
        if gap <= 1e-9:
            if first and near >= inside and dz < 0 and near > _NEAR_MM:
                return t, 0.0, 0.0, 1.0
            if gap > -1e-3 or first:
                return t, *_relief_normal(m, x, y)
            step = last_t - t + (t - last_t) * last_gap / (last_gap - gap)
            t += step * 0.999
            continue
        # The height cannot change faster than its steepest slope: such a step never passes through the surface.
        # Close to it, a secant step is as safe and much longer.
        step = gap / fall
        if not first and gap < 0.3 and last_gap > gap:
            step = max(step, min(gap * (t - last_t) / (last_gap - gap), 4 * step))
        first, last_t, last_gap = False, t, gap
        t += max(step, floor)
    return _INF, 0.0, 0.0, 0.0


@compiled
def _relief_normal(m: Array, x: float, y: float) -> tuple[float, float, float]:
    e = 1e-4
    hx = relief_height(m[3], x / m[0] + e, y / m[1]) - relief_height(m[3], x / m[0] - e, y / m[1])
    hy = relief_height(m[3], x / m[0], y / m[1] + e) - relief_height(m[3], x / m[0], y / m[1] - e)
    gx, gy = m[2] * hx / (2 * e * m[0]), m[2] * hy / (2 * e * m[1])
    scale = -1 / np.sqrt(1 + gx * gx + gy * gy)
    return gx * scale, gy * scale, scale


@inline
def _meet(s: Table, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, floor: float) -> Hit:
    """The ray against shape i; origin and direction in the world, the normal in the shape's frame."""
    cx, cy, cz = ox - s.translation[i, 0], oy - s.translation[i, 1], oz - s.translation[i, 2]
    b = cx * dx + cy * dy + cz * dz
    px, py, pz = cx - b * dx, cy - b * dy, cz - b * dz
    if px * px + py * py + pz * pz > s.radius[i] * s.radius[i] or s.kind[i] == MESH:
        return _INF, 0.0, 0.0, 0.0
    r = s.rotation
    lx = r[i, 0, 0] * cx + r[i, 1, 0] * cy + r[i, 2, 0] * cz
    ly = r[i, 0, 1] * cx + r[i, 1, 1] * cy + r[i, 2, 1] * cz
    lz = r[i, 0, 2] * cx + r[i, 1, 2] * cy + r[i, 2, 2] * cz
    ex = r[i, 0, 0] * dx + r[i, 1, 0] * dy + r[i, 2, 0] * dz
    ey = r[i, 0, 1] * dx + r[i, 1, 1] * dy + r[i, 2, 1] * dz
    ez = r[i, 0, 2] * dx + r[i, 1, 2] * dy + r[i, 2, 2] * dz
    kind, dims = s.kind[i], s.dims[i]
    if kind == RECTANGLE:
        return _rectangle(dims, lx, ly, lz, ex, ey, ez)
    if kind == SPHERE:
        return _sphere(dims, lx, ly, lz, ex, ey, ez)
    if kind == BOX:
        return _box(dims, lx, ly, lz, ex, ey, ez)
    if kind == CYLINDER:
        return _cylinder(dims, lx, ly, lz, ex, ey, ez)
    return _relief(dims, lx, ly, lz, ex, ey, ez, floor)


@compiled
def nearest(s: Table, origin: Array, rays: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """First hits of rays from one origin: distance (n,) mm, shape (n,) or -1, unit normal (n, 3) in the world."""
    s, n = unowned(s), len(rays)
    distance, which, normal = np.full(n, _INF), np.full(n, -1), np.zeros((n, 3))
    for k in range(n):
        dx, dy, dz = rays[k, 0], rays[k, 1], rays[k, 2]
        nx, ny, nz = 0.0, 0.0, 0.0
        for i in range(len(s.kind)):
            t, ax, ay, az = _meet(s, i, origin[0], origin[1], origin[2], dx, dy, dz, 1e-9)
            if t < distance[k]:
                distance[k], which[k], nx, ny, nz = t, i, ax, ay, az
        if which[k] >= 0:
            r = s.rotation[which[k]]
            for c in range(3):
                normal[k, c] = r[c, 0] * nx + r[c, 1] * ny + r[c, 2] * nz
    return distance, which, normal


@compiled
def visible(s: Table, points: Array, normals: Array, viewer: Array) -> NDArray[np.bool_]:
    """Which surface points a viewer sees past all analytic shapes, (n,); NaN points are not visible."""
    s, points, normals = unowned(s), unowned(points), unowned(normals)
    seen = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        x, y, z = (
            points[k, 0] + _OFFSET_MM * normals[k, 0],
            points[k, 1] + _OFFSET_MM * normals[k, 1],
            points[k, 2] + _OFFSET_MM * normals[k, 2],
        )
        dx, dy, dz = viewer[0] - x, viewer[1] - y, viewer[2] - z
        if not dx * normals[k, 0] + dy * normals[k, 1] + dz * normals[k, 2] > 0:
            continue
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        free = True
        for i in range(len(s.kind)):
            t, _, _, _ = _meet(s, i, x, y, z, dx / length, dy / length, dz / length, _SHADOW_STEP_MM)
            if t < length:
                free = False
                break
        seen[k] = free
    return seen
