"""Triangle meshes: read by trimesh, intersected by Embree, refined in double precision."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_OFFSET_MM = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A mesh about its own origin: corners (m, 3, 3) and unit normals (m, 3) of the triangles, and Embree's tree."""

    corners: Array
    normals: Array
    tree: Any

    def nearest(self, origin: Array, rays: Array) -> tuple[Array, NDArray[np.int64]]:
        """Distance (n,) mm, ``inf`` for a miss, and triangle (n,); origin (3,) and unit rays (n, 3) in its frame."""
        starts = np.broadcast_to(origin, rays.shape)
        which = np.asarray(self.tree.run(_single(starts), _single(rays)), dtype=np.int64)
        normal = self.normals[which]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.sum((self.corners[which, 0] - starts) * normal, axis=1) / np.sum(rays * normal, axis=1)
        missed = (which < 0) | ~np.isfinite(distance) | (distance <= 0)
        return np.where(missed, np.inf, distance), np.where(missed, -1, which)

    def blocks(self, points: Array, viewer: Array) -> NDArray[np.bool_]:
        """Whether the mesh occludes each point (n, 3) for the viewer (3,), all in its frame."""
        away = viewer - points
        length = np.linalg.norm(away, axis=1, keepdims=True)
        which = np.asarray(self.tree.run(_single(points + _OFFSET_MM * away / length), _single(away / length)))
        return which >= 0


def _single(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


@lru_cache(maxsize=4)
def load(path: Path, radius_mm: float) -> Mesh:
    """The mesh of a file (OBJ, PLY, STL ...), y up in the file, turned towards the rig and scaled into a sphere."""
    import trimesh
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    if not path.is_file():
        raise ValueError(f"mesh {path}: no such file; set sim.mesh to an OBJ, PLY or STL file")
    try:
        found = trimesh.load(path, force="mesh", process=True)
        vertices, faces = np.asarray(found.vertices, np.float64), np.asarray(found.faces)
    except Exception as error:
        raise ValueError(f"mesh {path} cannot be read: {error}") from error
    if faces.size == 0 or not np.isfinite(vertices).all():
        raise ValueError(f"mesh {path} holds no triangles with finite corners")
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    vertices = (vertices - centre) * np.array([1.0, -1.0, -1.0])
    vertices *= radius_mm / np.linalg.norm(vertices, axis=1).max()
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    corners, normals = corners[area > 1e-9], normals[area > 1e-9] / area[area > 1e-9, None]
    tree = rtcore_scene.EmbreeScene()
    TriangleMesh(tree, _single(corners))
    return Mesh(corners, normals, tree)
