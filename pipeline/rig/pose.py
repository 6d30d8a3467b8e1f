"""A rigid pose: the transform of points from the left camera's frame into another one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError

TOLERANCE = 1e-4
"""Largest element of R R^T - 1 of a rotation: 0.1 mm in a metre."""
FARTHEST_MM = 1e5
LEFT = "left"
"""Name of the left camera's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """X_frame = R X_left + t.

    Args:
        rotation: (3, 3); translation: (3,), mm; frame: name of the frame that points are transformed into.
    """

    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    translation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    frame: str = LEFT

    @staticmethod
    def of_matrix(rows: Any, frame: str, *, name: str = "pose") -> Pose:
        """The pose of a 4 x 4 matrix.

        Args:
            rows: four rows of four numbers; name: of the setting or file, for messages.

        Raises:
            CalibrationError: not such a matrix, or not rigid, with the value and the limit.
        """
        try:
            matrix = np.array(rows, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise CalibrationError(f"{name} must be four rows of four numbers") from error
        if matrix.shape != (4, 4):
            raise CalibrationError(f"{name} must be four rows of four numbers, it has the shape {list(matrix.shape)}")
        if not np.isfinite(matrix).all():
            raise CalibrationError(f"{name} has elements that are not finite numbers")
        if (matrix[3] != (0, 0, 0, 1)).any():
            raise CalibrationError(
                f"{name} has the last row {matrix[3].tolist()}; that of a rigid pose is [0, 0, 0, 1]"
            )
        rotation, translation = matrix[:3, :3], matrix[:3, 3]
        shear = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if shear > TOLERANCE:
            raise CalibrationError(
                f"{name} is not rigid: R R^T differs from the identity by {shear:.3g}, limit {TOLERANCE:g}; write its "
                "rotation with six digits, without scale or shear"
            )
        if np.linalg.det(rotation) < 0:
            raise CalibrationError(f"{name} mirrors (determinant -1); the rotation of a rigid pose has determinant +1")
        far = float(np.abs(translation).max())
        if far > FARTHEST_MM:
            raise CalibrationError(f"{name} has a translation of {far:g} mm, limit {FARTHEST_MM:g} mm")
        # The nearest rotation: distances stay what they were, whatever digits the file has.
        u, _, v = np.linalg.svd(rotation)
        return Pose(u @ v, translation.copy(), frame)

    @property
    def matrix(self) -> NDArray[np.float32]:
        """Rotation and translation, (3, 4), for kernels."""
        return np.concatenate([self.rotation, self.translation[:, None]], axis=1).astype(np.float32)

    def points(self, xyz: NDArray[np.float32]) -> NDArray[np.float32]:
        """Points (..., 3) in the pose's frame; NaN stays NaN."""
        moved = xyz @ self.rotation.T.astype(np.float32)
        moved += self.translation.astype(np.float32)
        return moved

    def normals(self, normals: NDArray[np.float32]) -> NDArray[np.float32]:
        """Normals (..., 3) in the pose's frame: rotated, not displaced."""
        return normals @ self.rotation.T.astype(np.float32)
