"""The full camera model: pinhole with skew, three radial and two tangential terms, and a pose.

World frame = frame of the left camera. ``X_device = R X_world + t``; the image point is ``u = fx x_d + skew y_d + cx``,
``v = fy y_d + cy`` with the distorted normalised point (x_d, y_d) after Brown, 1971, in OpenCV's order of coefficients.
All in float64: the reference for tests of faster kernels.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError

Array = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-6
_UNDISTORT_STEPS = 20
_ROWS = 16


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """One device (a camera, or a projector as an inverse camera).

    Args:
        size: (width, height), pixels.
        matrix: (3, 3) intrinsic matrix with skew.
        distortion: (5,) k1, k2, p1, p2, k3.
        rotation: (3, 3), world to device.
        translation: (3,), mm.
    """

    size: tuple[int, int]
    matrix: Array
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))
    name: str = "device"

    def __post_init__(self) -> None:
        for key, shape in (("matrix", (3, 3)), ("distortion", (5,)), ("rotation", (3, 3)), ("translation", (3,))):
            value = np.array(getattr(self, key), dtype=np.float64)
            if value.shape != shape:
                raise CalibrationError(f"{self.name}.{key} has shape {value.shape}, expected {shape}")
            if not np.isfinite(value).all():
                raise CalibrationError(f"{self.name}.{key} holds a value that is not finite")
            value.setflags(write=False)
            object.__setattr__(self, key, value)
        self._check_intrinsics()
        self._check_rotation()

    def _check_intrinsics(self) -> None:
        width, height = self.size
        if not (0 < width <= 65535 and 0 < height <= 65535):
            raise CalibrationError(f"{self.name}.size is {self.size}, expected two numbers from 1 to 65535")
        m = self.matrix
        if m[0, 0] <= 0 or m[1, 1] <= 0:
            raise CalibrationError(f"{self.name}.matrix has focal lengths {m[0, 0]}, {m[1, 1]}; both must be positive")
        if m[1, 0] != 0 or (m[2] != (0, 0, 1)).any():
            raise CalibrationError(f"{self.name}.matrix must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]")

    def _check_rotation(self) -> None:
        error = float(np.abs(self.rotation @ self.rotation.T - np.eye(3)).max())
        if error > _ROTATION_TOLERANCE:
            raise CalibrationError(
                f"{self.name}.rotation is not a rotation: R R^T differs from the identity by {error:.3g} "
                f"(limit {_ROTATION_TOLERANCE:g}); calibrate again or orthonormalise it"
            )
        if np.linalg.det(self.rotation) < 0:
            raise CalibrationError(f"{self.name}.rotation mirrors (determinant -1); a rotation has determinant +1")

    @property
    def centre(self) -> Array:
        """Centre of projection in the world, (3,), mm."""
        return np.asarray(-self.rotation.T @ self.translation)

    def distort(self, points: Array) -> Array:
        """Distorted normalised points of ideal normalised points, (..., 2) -> (..., 2)."""
        return distort(points, self.distortion)

    def undistort(self, points: Array) -> Array:
        """Ideal normalised points of distorted normalised points, (..., 2) -> (..., 2), by Newton's method."""
        return undistort(points, self.distortion)

    def project(self, world: Array) -> Array:
        """Pixels (u, v) of world points, (..., 3) mm -> (..., 2); NaN behind the device."""
        device = world @ self.rotation.T + self.translation
        z = np.where(device[..., 2] > 0, device[..., 2], np.nan)
        return self.to_pixels(self.distort(device[..., :2] / z[..., None]))

    def to_pixels(self, distorted: Array) -> Array:
        """Pixels of distorted normalised points, (..., 2) -> (..., 2)."""
        m = self.matrix
        u = m[0, 0] * distorted[..., 0] + m[0, 1] * distorted[..., 1] + m[0, 2]
        return np.stack([u, m[1, 1] * distorted[..., 1] + m[1, 2]], axis=-1)

    def normalise(self, pixels: Array) -> Array:
        """Ideal normalised points of pixels, (..., 2) -> (..., 2); multiply (x, y, 1) by the depth for a point."""
        m = self.matrix
        y = (pixels[..., 1] - m[1, 2]) / m[1, 1]
        x = (pixels[..., 0] - m[0, 2] - m[0, 1] * y) / m[0, 0]
        return self.undistort(np.stack([x, y], axis=-1))

    def rays(self) -> Array:
        """Ideal normalised point of every pixel, (H, W, 2); in the left camera xyz = z (x, y, 1)."""
        width, height = self.size
        rays = np.empty((height, width, 2))
        for top in range(0, height, _ROWS):  # the intermediate arrays of a block stay in the processor's cache
            block = rays[top : top + _ROWS]
            v, u = np.indices(block.shape[:2], dtype=np.float64)
            block[:] = self.normalise(np.stack([u, v + top], axis=-1))
        return rays

    def cropped(self, left: int, top: int, width: int, height: int) -> CameraModel:
        """The same device with a region of its sensor."""
        matrix = self.matrix.copy()
        matrix[0, 2] -= left
        matrix[1, 2] -= top
        return CameraModel((width, height), matrix, self.distortion, self.rotation, self.translation, self.name)

    def as_mapping(self) -> dict[str, Any]:
        """The keys of the calibration file."""
        return {
            "size": list(self.size),
            "matrix": self.matrix.tolist(),
            "distortion": self.distortion.tolist(),
            "rotation": self.rotation.tolist(),
            "translation": self.translation.tolist(),
        }


def distort(points: Array, coefficients: Array) -> Array:
    """Apply k1, k2, p1, p2, k3 to ideal normalised points, (..., 2) -> (..., 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def distortion_slopes(points: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """Derivatives of :func:`distort` at points (..., 2): x by x, x by y (which is y by x), y by y."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return xx, xy, yy


def undistort(points: Array, coefficients: Array) -> Array:
    """Invert :func:`distort` by Newton steps with the analytic Jacobian; converges to rounding for real lenses."""
    target = np.asarray(points, dtype=np.float64)
    current = target.copy()
    for _ in range(_UNDISTORT_STEPS):
        error = distort(current, coefficients) - target
        xx, xy, yy = distortion_slopes(current, coefficients)
        det = xx * yy - xy * xy
        step = np.stack(
            [(yy * error[..., 0] - xy * error[..., 1]) / det, (xx * error[..., 1] - xy * error[..., 0]) / det], axis=-1
        )
        current = current - step
        if step.size == 0 or np.nanmax(np.abs(step)) < 1e-15:
            break
    return current
