"""Shapes in front of the rig, with pose, colour and motion."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.scene.printed_marks import Ink
from sim.scene.ray_intersection import BOX, CYLINDER, MESH, RECTANGLE, RELIEF, SPHERE, Table, relief_heights

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
_NOT_BOUNDED = 1e9


@dataclass(frozen=True, slots=True)
class Motion:
    """A smooth closed motion about the rest pose.

    Args:
        swing_mm: amplitude of a sine along each axis of the stage.
        turn_rad: amplitude of a sine turn about ``axis``.
        axis: axis of the turn, in the shape's own frame.
        cycles: cycles in one period of the scene; a whole number closes the loop.
        phase_rad: phase in the cycle at time 0; the turn is a quarter ahead.
    """

    swing_mm: Triple = (0.0, 0.0, 0.0)
    turn_rad: float = 0.0
    axis: Triple = (0.0, 1.0, 0.0)
    cycles: int = 1
    phase_rad: float = 0.0

    def at(self, share: float) -> tuple[Array, Array]:
        """(R, t) at a share of the scene's period: turn in the shape's frame, shift on the stage."""
        angle = 2 * np.pi * self.cycles * share + self.phase_rad
        return rotation_about(self.axis, self.turn_rad * np.cos(angle)), np.sin(angle) * np.array(self.swing_mm)


@dataclass(frozen=True, slots=True)
class Texture:
    """Amplitude and grain (mm) of smooth stains and of speckle; ``seed`` varies them."""

    smooth: float = 0.0
    smooth_mm: float = 30.0
    speckle: float = 0.0
    speckle_mm: float = 3.0
    seed: int = 0


COLORED = Texture(smooth=0.35, smooth_mm=28.0, speckle=0.10, speckle_mm=3.0)


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape; created by the functions below.

    Args:
        kind: number of the kind, see :mod:`sim.scene.ray_intersection`.
        dims: sizes, mm, (at most 6), depending on the kind.
        radius_mm: of the bounding sphere about the shape's origin.
        at_mm: position on the stage.
        turn: rotation vector on the stage, radians.
        albedo: R G B, 0..1, before the texture.
        motion: None = rests.
        mesh: file of a triangle mesh, only for that kind.
        ink: printed on its front, only for a rectangle.
        gloss: strength and exponent of the mirror-like part of the reflection (Blinn, 1977); 0 = matt.
    """

    kind: int
    dims: tuple[float, ...]
    radius_mm: float
    at_mm: Triple = (0.0, 0.0, 0.0)
    turn: Triple = (0.0, 0.0, 0.0)
    albedo: Triple = (0.8, 0.8, 0.8)
    texture: Texture = field(default_factory=Texture)
    motion: Motion | None = None
    mesh: Path | None = None
    ink: Ink | None = None
    gloss: tuple[float, float] = (0.0, 1.0)

    def pose(self, share: float) -> tuple[Array, Array]:
        """(R, t) with ``X_stage = R X_shape + t`` at a share of the scene's period."""
        rotation, place = rotation_about(self.turn, float(np.linalg.norm(self.turn))), np.array(self.at_mm)
        if self.motion is None:
            return rotation, place
        turn, shift = self.motion.at(share)
        return rotation @ turn, place + shift

    def placed(
        self,
        at_mm: Triple = (0.0, 0.0, 0.0),
        *,
        turn: Triple = (0.0, 0.0, 0.0),
        albedo: Triple | float = 0.8,
        texture: Texture | None = None,
        motion: Motion | None = None,
        gloss: tuple[float, float] = (0.0, 1.0),
    ) -> Shape:
        """The same shape at another pose, with its own colour, texture and motion."""
        color = (albedo,) * 3 if isinstance(albedo, float | int) else albedo
        texture = texture or Texture()
        return replace(self, at_mm=at_mm, turn=turn, albedo=color, texture=texture, motion=motion, gloss=gloss)


def rectangle(width_mm: float, height_mm: float, *, ink: Ink | None = None) -> Shape:
    """A thin board in the plane z = 0, seen from both sides; ``ink`` is seen from the side z < 0."""
    a, b = width_mm / 2, height_mm / 2
    return Shape(RECTANGLE, (a, b), float(np.hypot(a, b)), ink=ink)


def plane() -> Shape:
    """An infinite plane, z = 0."""
    return Shape(RECTANGLE, (_NOT_BOUNDED, _NOT_BOUNDED), _NOT_BOUNDED)


def sphere(radius_mm: float) -> Shape:
    """A ball about the origin."""
    return Shape(SPHERE, (radius_mm,), radius_mm)


def box(width_mm: float, height_mm: float, depth_mm: float) -> Shape:
    """A block about the origin."""
    half = (width_mm / 2, height_mm / 2, depth_mm / 2)
    return Shape(BOX, half, float(np.linalg.norm(half)))


def cylinder(radius_mm: float, length_mm: float) -> Shape:
    """A closed cylinder about the y axis."""
    return Shape(CYLINDER, (radius_mm, length_mm / 2), float(np.hypot(radius_mm, length_mm / 2)))


def relief(width_mm: float, height_mm: float, depth_mm: float, *, variant: str = "face") -> Shape:
    """A relief towards the rig over an ellipse in z = 0: ``face`` (with nose, eyes and mouth) or ``waves``."""
    number = {"face": 0.0, "waves": 1.0}[variant]
    a, b = width_mm / 2, height_mm / 2
    q, p = np.mgrid[-1:1:301j, -1:1:301j]
    heights = depth_mm * relief_heights(number, p, q)
    rows, columns = np.gradient(heights, b * 2 / 300, a * 2 / 300)
    steepest, highest = float(np.hypot(rows, columns).max()), float(heights.max())
    radius = float(np.hypot(max(a, b), highest * 1.02))
    return Shape(RELIEF, (a, b, depth_mm, number, 1.15 * steepest, highest * 1.01 + 0.1), radius)


def mesh(path: Path, radius_mm: float) -> Shape:
    """A triangle mesh from a file, scaled and centred so that a sphere of this radius holds it."""
    return Shape(MESH, (), radius_mm, mesh=path)


def rotation_about(axis: Triple, angle: float) -> Array:
    """Rotation matrix, (3, 3), about an axis (Rodrigues)."""
    length = float(np.linalg.norm(axis))
    if length == 0 or angle == 0:
        return np.eye(3)
    x, y, z = np.array(axis) / length
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k))


def table_of(shapes: tuple[Shape, ...], share: float, stage: tuple[Array, Array]) -> Table:
    """All shapes at one instant in the world, as a table for compiled code."""
    n = len(shapes)
    kind, radius = np.array([s.kind for s in shapes], np.int64), np.array([s.radius_mm for s in shapes])
    rotation, translation, dims = np.empty((n, 3, 3)), np.empty((n, 3)), np.zeros((n, 6))
    base, texture = np.empty((n, 3)), np.empty((n, 5))
    for i, shape in enumerate(shapes):
        turn, place = shape.pose(share)
        rotation[i], translation[i] = stage[0] @ turn, stage[0] @ place + stage[1]
        dims[i, : len(shape.dims)] = shape.dims
        t = shape.texture
        base[i], texture[i] = shape.albedo, (t.smooth, t.smooth_mm, t.speckle, t.speckle_mm, 2 * t.seed + 1000 * i)
    return Table(kind, rotation, translation, dims, radius * 1.0001 + 1e-6, base, texture)
