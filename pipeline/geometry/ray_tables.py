"""Geometry of every lattice pixel's viewing ray, reduced to a few numbers.

Along one ray let w = 1/z run linearly from the far limit (s = 0) to the near one (s = 1). The image of the ray's points
in a pinhole device is then exactly ``u(s) = (c0 + c1 s) / (1 + c2 s)``, with the same c2 for its two coordinates. The
parameter s drops out: from a projector coordinate p follows the coordinate along the fringes' growth in the other
camera, ``m = (m0 + m1 p) / (1 + m2 p)``, from that the one across it, ``q0 + q1 m`` (the epipolar line), and the
projector's other coordinate, ``r0 + r1 p`` likewise: seven numbers and one division instead of three projections. Lens
distortion changes this by far less than a pixel; samples at s = 0, 1/2 and 1 determine the numbers, and only the choice
of the fringe order uses them: the final point is computed with the full models.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_CONSTANT_PX = 1e-6
"""Change along the ray, pixels, below which a coordinate is taken as constant."""


def packed(device: CameraModel) -> F64:
    """(22,) for :func:`pipeline.common.jit.project`: [R | t] by rows, fx, skew, cx, fy, cy, k1, k2, p1, p2, k3."""
    m = device.matrix
    pose = np.concatenate([device.rotation, device.translation[:, None]], axis=1).ravel()
    return np.concatenate([pose, [m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2]], device.distortion])


@dataclass(frozen=True, slots=True, eq=False)
class RayTable:
    """Geometry of one camera's lattice pixels in the other devices.

    Args:
        top, down: lattice row a is image row ``top + down a``; left, step: column b is column ``left + step b``.
        along: (3, h, w) float32, c0, c1, c2 (see the module) of the projector coordinate along which the phase grows.
        lines: (7, h, w) float32, m0, m1, m2, q0, q1, r0, r1 (see the module).
        limits: (2, h, w) float32, the least and the largest s of the ray inside the measuring volume.
    """

    top: int
    down: int
    left: int
    step: int
    along: F32
    lines: F32
    limits: F32

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the lattice."""
        return self.limits.shape[1], self.limits.shape[2]

    def every_second(self) -> RayTable:
        """The table of every second lattice pixel in both directions."""
        return RayTable(
            top=self.top,
            down=2 * self.down,
            left=self.left,
            step=2 * self.step,
            along=np.ascontiguousarray(self.along[:, ::2, ::2]),
            lines=np.ascontiguousarray(self.lines[:, ::2, ::2]),
            limits=np.ascontiguousarray(self.limits[..., ::2, ::2]),
        )

    def sampled(self, plane: NDArray[Any]) -> NDArray[Any]:
        """A plane's values at the lattice pixels, a view (h, w)."""
        return plane[self.top :: self.down, self.left :: self.step][: self.shape[0], : self.shape[1]]


@dataclass(frozen=True, slots=True)
class DepthScale:
    """1/z as a linear function of s: w(s) = base + span s, 1/mm."""

    base: float
    span: float

    @staticmethod
    def of(volume: Volume) -> DepthScale:
        """S = 0 at the far limit, 1 at the near one."""
        return DepthScale(1 / volume.far_mm, 1 / volume.near_mm - 1 / volume.far_mm)

    def depth(self, s: float) -> float:
        """Z in mm."""
        return 1 / (self.base + self.span * s)

    def range_of(self, volume: Volume, tolerance: float) -> tuple[float, float]:
        """Least and largest s in a volume, and a share of their difference beyond."""
        far, near = ((1 / z - self.base) / self.span for z in (volume.far_mm, volume.near_mm))
        return far - tolerance * (near - far), near + tolerance * (near - far)


def ray_table(
    calibration: Calibration,
    depth: DepthScale,
    *,
    axis: str,
    step: tuple[int, int],
    margin: int = 3,
    inside: tuple[CameraModel, Volume] | None = None,
) -> RayTable:
    """Tables of the calibration's left camera (pass ``calibration.swapped()`` for the right one).

    Args:
        step: of the lattice, (x, y) pixels; margin: pixels left out at the border.
        inside: the camera whose z axis the measuring volume is given along, and the volume; None = this camera's own,
            the whole range of s.
    """
    width, height = calibration.left.size
    rows = np.arange(margin, height - margin, step[1], dtype=np.int32)
    columns = np.arange(margin, width - margin, step[0], dtype=np.int32)
    v, u = np.meshgrid(rows, columns, indexing="ij")
    rays = calibration.left.normalise(np.stack([u, v], axis=-1).astype(np.float64))
    direction = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    points = [direction * depth.depth(s) for s in (0.0, 0.5, 1.0)]
    projector = [calibration.projector.project(p) for p in points]
    other = [calibration.right.project(p) for p in points]
    first = 0 if axis == "x" else 1
    along = _homography([p[..., first] for p in projector], "projector")
    across = _homography([p[..., 1 - first] for p in projector], "projector", along[2])
    main = _homography([p[..., first] for p in other], "other camera")
    side = _homography([p[..., 1 - first] for p in other], "other camera", main[2])
    return RayTable(
        top=margin,
        down=step[1],
        left=margin,
        step=step[0],
        along=along.astype(np.float32),
        lines=np.concatenate([_composed(along, main), _line(main, side), _line(along, across)]).astype(np.float32),
        limits=_limits(direction, depth, inside),
    )


def _limits(direction: F64, depth: DepthScale, inside: tuple[CameraModel, Volume] | None) -> F32:
    """(2, h, w) range of s in which a ray's points lie in the volume."""
    if inside is None:
        whole = np.zeros((2, *direction.shape[:2]), np.float32)
        whole[1] = 1.0
        return whole
    camera, volume = inside
    # A point of the ray is direction / w; along the other camera's axis z = (r3 . direction) / w + t3.
    slope = direction @ camera.rotation[2]
    w = [slope / (z - camera.translation[2]) for z in (volume.far_mm, volume.near_mm)]
    s = np.sort((np.stack(w) - depth.base) / depth.span, axis=0)
    return np.clip(s, 0.0, 1.0).astype(np.float32)


def _homography(values: list[F64], name: str, denominator: F64 | None = None) -> F64:
    """c0, c1, c2, (3, h, w), through the values at s = 0, 1/2, 1, or at 0 and 1 with a given c2.

    A coordinate that hardly changes along the ray does not determine its denominator, which is then 0.
    """
    u0, uh, u1 = values
    if not np.isfinite(u0 + uh + u1).all():
        raise CalibrationError(f"part of the measuring volume lies behind the {name}; check its pose and the volume")
    if denominator is None:
        # (c0 + c1 s) / (1 + c2 s): 2 uh + uh c2 = 2 c0 + c1 and u1 + u1 c2 = c0 + c1.
        with np.errstate(divide="ignore", invalid="ignore"):
            denominator = np.where(np.abs(u1 - uh) > 0.5, (2 * uh - u0 - u1) / (u1 - uh), 0.0)
    return np.stack([u0, u1 * (1 + denominator) - u0, denominator])


def _composed(a: F64, b: F64) -> F64:
    """m0, m1, m2, (3, h, w), of ``(m0 + m1 u) / (1 + m2 u)``: coordinate b where a is u.

    Where a does not change along the ray it is the middle of b's range.
    """
    scale = a[1] - b[2] * a[0]
    varies = np.abs(scale) > _CONSTANT_PX
    scale = np.where(varies, scale, 1.0)
    out = np.stack([b[0] * a[1] - b[1] * a[0], b[1] - b[0] * a[2], b[2] - a[2]]) / scale
    middle = (b[0] + b[1] / 2) / (1 + b[2] / 2)
    return np.where(varies, out, np.stack([middle, np.zeros_like(middle), np.zeros_like(middle)]))


def _line(a: F64, b: F64) -> F64:
    """q0, q1, (2, h, w), of ``q0 + q1 u``: coordinate b where a, of the same device, is u."""
    return _composed(a, b)[:2]


def period_in_image(calibration: Calibration, depth: DepthScale, *, axis: str, period: float) -> float:
    """Fringe period in the left camera's image at mid-volume, pixels, along the direction of growth."""
    width, height = calibration.left.size
    first = 0 if axis == "x" else 1
    centre = np.array([[width / 2, height / 2], [width / 2, height / 2]])
    centre[1, first] += 1.0
    rays = calibration.left.normalise(centre)
    points = np.concatenate([rays, np.ones((2, 1))], axis=1) * depth.depth(0.5)
    step = float(np.diff(calibration.projector.project(points)[:, first])[0])
    return float(np.clip(period / max(abs(step), 1e-6), 3.0, 0.25 * min(width, height)))
