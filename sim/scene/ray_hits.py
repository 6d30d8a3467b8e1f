"""First hits of rays on the analytic shapes and meshes of a scene at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.scene import ray_intersection
from sim.scene.mesh import Mesh, load
from sim.scene.printed_marks import Cells, darken
from sim.scene.ray_intersection import MESH, Table
from sim.scene.scene import Scene
from sim.scene.shapes import table_of

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """First hits of n rays: points (n, 3) mm (NaN for a miss), unit normals (n, 3) to the viewer, shape (n,) or -1."""

    points: Array
    normals: Array
    which: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """All surfaces of a scene at one instant, in the world."""

    table: Table
    meshes: tuple[tuple[int, Mesh], ...]
    prints: tuple[tuple[int, Cells], ...] = ()
    glosses: tuple[tuple[int, float, float], ...] = ()

    def hits(self, origin: Array, rays: Array) -> Hits:
        """First hits of unit rays (n, 3) from one origin (3,)."""
        distance, which, normals = ray_intersection.nearest(self.table, origin, rays)
        for index, mesh in self.meshes:
            rotation, place = self.table.rotation[index], self.table.translation[index]
            far, triangle = mesh.nearest((origin - place) @ rotation, rays @ rotation)
            nearer = far < distance
            distance[nearer], which[nearer] = far[nearer], index
            normals[nearer] = mesh.normals[triangle[nearer]] @ rotation.T
            # A triangle has two sides; the normal of the visible one is used.
            normals[nearer] *= -np.sign(np.sum(normals[nearer] * rays[nearer], axis=1, keepdims=True))
        points = np.where(which[:, None] >= 0, origin + np.where(which >= 0, distance, 0.0)[:, None] * rays, np.nan)
        return Hits(points, normals, which)

    def visible_from(self, hits: Hits, viewer: Array) -> Bools:
        """Which hits a viewer at a position (3,) sees: without occlusion, and from the same side."""
        visible = ray_intersection.visible(self.table, hits.points, hits.normals, viewer)
        for index, mesh in self.meshes:
            rotation, place = self.table.rotation[index], self.table.translation[index]
            candidates = np.flatnonzero(visible)
            points = (hits.points[candidates] - place) @ rotation
            visible[candidates] &= ~mesh.blocks(points, (viewer - place) @ rotation)
        return np.asarray(visible)

    def darken(self, light: NDArray[np.float32], hits: Hits, viewer: Array, spread: float) -> None:
        """Reduce the light that hits reflect, (n, 3), by what ink absorbs; in place.

        Args:
            light, hits: of the same rays; viewer: (3,) their origin; spread: angle between neighbours, radians.
        """
        for index, cells in self.prints:
            pose = self.table.rotation[index], self.table.translation[index]
            darken(light, cells, pose, hits.points, hits.which == index, viewer, spread)

    def add_gloss(self, light: NDArray[np.float32], hits: Hits, viewer: Array, lamp: Array) -> None:
        """Add the mirror-like reflection of glossy shapes to the light of hits, (n, 3), in place (Blinn, 1977).

        Args:
            light, hits: of the same rays; viewer, lamp: (3,) centres of the camera and of the projector.
        """
        for index, strength, exponent in self.glosses:
            on = hits.which == index
            to_lamp, to_viewer = (_unit(centre - hits.points[on]) for centre in (lamp, viewer))
            normals, half = hits.normals[on], _unit(to_lamp + to_viewer)
            cosine = np.maximum(np.sum(normals * to_lamp, axis=1), 0.05)
            mirror = strength * np.maximum(np.sum(normals * half, axis=1), 0.0) ** exponent / cosine
            light[on] *= (1 + mirror[:, None] / self.table.base[index]).astype(np.float32)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def surfaces(scene: Scene, t_s: float, stage: tuple[Array, Array]) -> Surfaces:
    """The surfaces of a scene at a time; ``stage`` is (R, t) from stage to world."""
    table = table_of(scene.shapes, scene.share(t_s), stage)
    meshes = tuple(
        (i, load(shape.mesh, shape.radius_mm))
        for i, shape in enumerate(scene.shapes)
        if shape.kind == MESH and shape.mesh is not None
    )
    prints = tuple((i, shape.ink.cells()) for i, shape in enumerate(scene.shapes) if shape.ink is not None)
    glosses = tuple((i, *shape.gloss) for i, shape in enumerate(scene.shapes) if shape.gloss[0] > 0)
    return Surfaces(table, meshes, prints, glosses)
