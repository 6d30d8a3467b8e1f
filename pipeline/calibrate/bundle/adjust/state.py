"""All unknowns of a calibration, and their change by a step.

Order in the vector of unknowns: 16 numbers a device (ten of :data:`INTRINSICS`, six of :data:`POSE`), six a view (the
board's pose in the world), three a mark on the board. Rotations are stepped from the left, ``R <- exp([w]x) R``, so a
rotation's unknown is a small rotation in radians about the axes of its target frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]

INTRINSICS = ("fx", "fy", "skew", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
POSE = ("rotation_x", "rotation_y", "rotation_z", "translation_x", "translation_y", "translation_z")
PER_DEVICE = len(INTRINSICS) + len(POSE)
PER_VIEW = len(POSE)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Values of all unknowns.

    Args:
        intrinsics: (d, 10), see :data:`INTRINSICS`.
        rotations, translations: (d, 3, 3) and (d, 3), world to device.
        view_rotations, view_translations: (v, 3, 3) and (v, 3), board to world.
        points: (n, 3) marks on the board, mm.
    """

    intrinsics: Array
    rotations: Array
    translations: Array
    view_rotations: Array
    view_translations: Array
    points: Array

    @property
    def devices(self) -> int:
        """Number of devices."""
        return len(self.intrinsics)

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.view_rotations)

    def stepped(self, step: Array) -> State:
        """The state after a step of all unknowns, (16 d + 6 v + 3 n,) or without the last 3 n."""
        d, v = self.devices, self.views
        of_devices = step[: PER_DEVICE * d].reshape(d, PER_DEVICE)
        of_views = step[PER_DEVICE * d : PER_DEVICE * d + PER_VIEW * v].reshape(v, PER_VIEW)
        of_points = step[PER_DEVICE * d + PER_VIEW * v :]
        return State(
            self.intrinsics + of_devices[:, :10],
            rotated(self.rotations, of_devices[:, 10:13]),
            self.translations + of_devices[:, 13:],
            rotated(self.view_rotations, of_views[:, :3]),
            self.view_translations + of_views[:, 3:],
            self.points + of_points.reshape(-1, 3) if len(of_points) else self.points,
        )

    def scaled(self, factor: float) -> State:
        """The same images of a world that is larger by a factor."""
        return replace(
            self,
            translations=self.translations * factor,
            view_translations=self.view_translations * factor,
            points=self.points * factor,
        )

    def model(self, device: int, name: str, size: tuple[int, int]) -> CameraModel:
        """One device as a camera model."""
        fx, fy, skew, cx, cy, k1, k2, p1, p2, k3 = self.intrinsics[device]
        matrix = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])
        u, _, vt = np.linalg.svd(self.rotations[device])
        rotation = np.eye(3) if (self.rotations[device] == np.eye(3)).all() else u @ vt
        return CameraModel(size, matrix, np.array([k1, k2, p1, p2, k3]), rotation, self.translations[device], name)

    def with_views(self, rotations: Array, translations: Array) -> State:
        """The same devices with other poses of the board."""
        return replace(self, view_rotations=rotations, view_translations=translations)


def intrinsics_of(model: CameraModel) -> Array:
    """The ten numbers of :data:`INTRINSICS` of a device."""
    m = model.matrix
    return np.concatenate([[m[0, 0], m[1, 1], m[0, 1], m[0, 2], m[1, 2]], model.distortion])


def rotated(rotations: Array, vectors: Array) -> Array:
    """``exp([w]x) R`` for rotations (n, 3, 3) and vectors w (n, 3), radians (Rodrigues' formula)."""
    return np.asarray(rotation_matrices(vectors) @ rotations)


def rotation_matrices(vectors: Array) -> Array:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[:, None, None]
    cross = cross_matrices(vectors)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1 - angle**2 / 6, np.sin(safe) / safe)
    second = np.where(small, 0.5 - angle**2 / 24, 2 * (np.sin(safe / 2) / safe) ** 2)
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def cross_matrices(vectors: Array) -> Array:
    """Matrices (n, 3, 3) of the cross products with vectors (n, 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)]
    return np.stack(rows, axis=-2)
