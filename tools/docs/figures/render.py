"""Orthographic image of an organised cloud: neighbouring points joined to shaded triangles, with axes in mm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.rig.layout import RigLayout

Array = NDArray[Any]
_STEP_MM, _TICK_MM = 50.0, 100.0
_MARGIN = 110
_LIGHT = np.array([-0.45, -0.55, -0.70])


@dataclass(frozen=True, slots=True)
class View:
    """Direction of view, relative to the rig's axis.

    Args:
        yaw_deg: about the vertical; pitch_deg: from above; mm_per_pixel: scale; jump_mm: longest edge of a triangle.
    """

    yaw_deg: float = -30.0
    pitch_deg: float = 15.0
    mm_per_pixel: float = 0.26
    jump_mm: float = 4.0


@dataclass(slots=True)
class Rendering:
    """Image and axes, in pixels of the image.

    Args:
        pixels: (H, W, 4) uint8, transparent where there is no surface.
        grid, edges: lines (2, 2); labels: place, text, offset in points.
    """

    pixels: Array
    grid: list[Array] = field(default_factory=list)
    edges: list[Array] = field(default_factory=list)
    labels: list[tuple[Array, str, tuple[float, float]]] = field(default_factory=list)


def render(xyz: Array, color: Array, layout: RigLayout, view: View) -> Rendering:
    """Render a cloud.

    Args:
        xyz: (H, W, 3), mm, left camera; color: (H, W, 3), 0..1; layout: of the rig, whose stage has the axes.
    """
    rotation, origin = layout.stage_pose()
    stage = (xyz.astype(float) - origin) @ rotation
    faces, used = _triangles(stage, view.jump_mm)
    axes = _axes(view)
    vertices = stage.reshape(-1, 3)[used]
    seen = vertices @ axes.T  # right, down, depth
    low = _corners(vertices) @ axes.T
    corner, size = low.min(axis=0), np.ptp(low, axis=0)
    width, height = (int(side / view.mm_per_pixel) + 2 * _MARGIN for side in size[:2])
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    plane = np.stack([columns - _MARGIN, rows - _MARGIN], axis=-1).reshape(-1, 2) * view.mm_per_pixel + corner[:2]
    starts = np.column_stack([plane, np.full(len(plane), seen[:, 2].min() - 50)])
    mesh = trimesh.Trimesh(seen, faces, process=False)
    hit, ray = mesh.ray.intersects_id(starts, np.tile([0.0, 0.0, 1.0], (len(starts), 1)), multiple_hits=False)
    pixels = np.zeros((height * width, 4), np.uint8)
    weights = _barycentric(seen[faces[hit]][..., :2], starts[ray, :2])
    shade = np.einsum("nk,nkc->nc", weights, color.reshape(-1, 3)[used][faces[hit]])
    normals = np.einsum("nk,nkc->nc", weights, _normals(vertices, faces)[faces[hit]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    brightness = 0.45 + 0.65 * np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    pixels[ray, :3] = np.clip(255 * shade * brightness[:, None], 0, 255)
    pixels[ray, 3] = 255
    rendering = Rendering(pixels.reshape(height, width, 4))
    _add_axes(rendering, vertices, lambda p: ((p @ axes.T)[..., :2] - corner[:2]) / view.mm_per_pixel + _MARGIN)
    return rendering


def _axes(view: View) -> Array:
    yaw, pitch = np.radians([view.yaw_deg, view.pitch_deg])
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return np.asarray(tilt @ turn)


def _triangles(points: Array, jump_mm: float) -> tuple[Array, Array]:
    """Triangles between neighbouring pixels, and the indices of the points that they use."""
    height, width = points.shape[:2]
    index = np.arange(height * width).reshape(height, width)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    flat = points.reshape(-1, 3)
    corners = flat[faces]
    with np.errstate(invalid="ignore"):
        long = np.max([np.linalg.norm(corners[:, i] - corners[:, i - 1], axis=1) for i in range(3)], axis=0)
        faces = faces[long < jump_mm]
    used, inverse = np.unique(faces, return_inverse=True)
    return inverse.reshape(-1, 3), used


def _normals(vertices: Array, faces: Array) -> Array:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    each = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(normals, faces[:, i], each)
    return normals


def _barycentric(triangles: Array, points: Array) -> Array:
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    u, v, w = b - a, c - a, points - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    area = np.where(np.abs(area) < 1e-12, 1e-12, area)
    second = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    third = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    weights: Array = np.clip(np.stack([1 - second - third, second, third], axis=-1), 0, 1)
    return weights


def _bounds(vertices: Array) -> tuple[Array, Array]:
    low, high = np.percentile(vertices, (0.02, 99.98), axis=0) + np.array([[-5.0], [5.0]])
    step = np.array([_STEP_MM, 10.0, _STEP_MM])
    return np.floor(low / step) * step, np.ceil(high / step) * step


def _corners(vertices: Array) -> Array:
    (x0, y0, z0), (x1, y1, z1) = _bounds(vertices)
    return np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)])


def _add_axes(rendering: Rendering, vertices: Array, place: Any) -> None:
    """A floor grid and three edges with ticks: x along the floor's front, z along its side, y at the back."""
    (x0, y0, z0), (x1, y1, z1) = _bounds(vertices)

    def line(*ends: tuple[float, float, float]) -> Array:
        return np.asarray(place(np.array(ends)))

    for x in np.arange(x0, x1 + 1, _STEP_MM):
        rendering.grid.append(line((x, y1, z0), (x, y1, z1)))
    for z in np.arange(z0, z1 + 1, _STEP_MM):
        rendering.grid.append(line((x0, y1, z), (x1, y1, z)))
    rendering.edges += [
        line((x0, y1, z0), (x1, y1, z0)),
        line((x1, y1, z0), (x1, y1, z1)),
        line((x0, y0, z1), (x0, y1, z1)),
    ]

    def ticks(low: float, high: float, point: Any, offset: tuple[float, float], name: str, far: float) -> None:
        inside = _TICK_MM / 5  # labels at the corners would overlap
        for value in np.arange(np.ceil((low + inside) / _TICK_MM), (high - inside) / _TICK_MM + 1e-9) * _TICK_MM:
            rendering.labels.append((line(point(value))[0], f"{value:+.0f}" if value else "0", offset))
        if name:
            middle = line(point((low + high) / 2))[0]
            rendering.labels.append((middle, name, (offset[0] * far, offset[1] * far)))

    ticks(x0, x1, lambda v: (v, y1, z0), (0, 9), "x, mm", 2.6)
    ticks(z0, z1, lambda v: (x1, y1, v), (15, 6), "z, mm", 2.4)
    ticks(y0, y1, lambda v: (x0, v, z1), (-15, 0), "", 0)
    rendering.labels.append((line((x0, y0, z1))[0], "y, mm", (0, 9)))
