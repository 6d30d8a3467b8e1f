"""Layout of a simulated rig: two converging cameras and a projector between them.

The stage is the frame of the measured objects: its origin is where all optical axes meet, x runs along the baseline,
y down, z away from the rig. The world is the left camera's frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration, ColorModel, Response
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume
from sim.rig.optics import Optics

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RigLayout:
    """Sizes and positions; the defaults are the project's standard rig.

    Args:
        camera_size: (width, height) of both cameras, pixels.
        focal_px: focal length of both cameras, pixels.
        baseline_mm: distance of the cameras.
        projector_fraction: position of the projector between left (0) and right (1).
        projector_up_mm: height of the projector above the baseline.
        standoff_mm: distance from each camera to the stage's origin.
        projector_size: (width, height), pixels.
        projector_focal_px: focal length of the projector; 4267 px light 420 mm of width at 1.4 m.
        periods: fringe periods over the projector's width.
        depth_mm: depth of the measuring volume, centred on the stage.
        lens: scale of all distortion; 0 = ideal lenses.
    """

    camera_size: tuple[int, int] = (1024, 820)
    focal_px: float = 3413.0
    baseline_mm: float = 500.0
    projector_fraction: float = 0.382
    projector_up_mm: float = 60.0
    standoff_mm: float = 1400.0
    projector_size: tuple[int, int] = (1280, 1024)
    projector_focal_px: float = 4267.0
    periods: float = 96.0
    depth_mm: float = 230.0
    lens: float = 1.0

    def __post_init__(self) -> None:
        for key in ("focal_px", "baseline_mm", "standoff_mm", "projector_focal_px", "periods", "depth_mm"):
            if not getattr(self, key) > 0:
                raise ValueError(f"layout.{key} is {getattr(self, key)}, expected more than 0")
        if self.baseline_mm >= 1.5 * self.standoff_mm:
            raise ValueError(
                f"layout.baseline_mm is {self.baseline_mm}, limit 1.5 x standoff_mm = {1.5 * self.standoff_mm}"
            )
        if self.depth_mm >= 1.5 * self.standoff_mm:
            raise ValueError(f"layout.depth_mm is {self.depth_mm}, limit 1.5 x standoff_mm = {1.5 * self.standoff_mm}")

    def scaled(self, factor: float) -> RigLayout:
        """The same rig and field with fewer (or more) pixels and periods, for quick tests."""
        return replace(
            self,
            camera_size=_scaled(self.camera_size, factor),
            projector_size=_scaled(self.projector_size, factor),
            focal_px=self.focal_px * factor,
            projector_focal_px=self.projector_focal_px * factor,
            periods=max(4.0, self.periods * factor),
        )

    def stage_pose(self) -> tuple[Array, Array]:
        """(R, t) with ``X_world = R X_stage + t``."""
        sine = self.baseline_mm / (2 * self.standoff_mm)
        cosine = np.sqrt(1 - sine * sine)
        rotation = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
        return rotation, np.array([0.0, 0.0, self.standoff_mm])

    def calibration(self) -> Calibration:
        """The true rig, without colour."""
        rotation, origin = self.stage_pose()
        right_centre = self.baseline_mm * rotation[:, 0]
        projector_centre = self.projector_fraction * right_centre - self.projector_up_mm * rotation[:, 1]
        left = self._camera("left", np.array([2.7, -1.9, 0.11]), np.array([-0.08, 0.10, 2e-4, -1.5e-4, 0.0]))
        right = self._camera("right", np.array([-3.4, 2.2, -0.07]), np.array([-0.075, 0.08, -1.2e-4, 2.2e-4, 0.0]))
        return Calibration(
            left, _aimed(right, right_centre, origin), _aimed(self._projector(), projector_centre, origin)
        )

    def calibration_for(self, optics: Optics) -> Calibration:
        """The calibration of this rig: with colours and response, and with the errors of ``optics``."""
        true = self.calibration()
        crosstalk = optics.calibrated_crosstalk()
        black = np.full(3, optics.black_dn)
        response = Response(*optics.response_table()) if optics.gamma != 1.0 else None
        projector = _misplaced(true.projector, optics.projector_error_px)
        return Calibration(
            true.left, true.right, projector, ColorModel(black, crosstalk[0]), ColorModel(black, crosstalk[1]), response
        )

    def pattern(self, periods: float | None = None, **options: Any) -> ColorFringe:
        """The colour fringe of this rig."""
        return ColorFringe(size=self.projector_size, periods=self.periods if periods is None else periods, **options)

    def volume(self) -> Volume:
        """The measuring volume along the left camera's z axis."""
        return Volume(self.standoff_mm - self.depth_mm / 2, self.standoff_mm + self.depth_mm / 2)

    def _camera(self, name: str, offset: Array, distortion: Array) -> CameraModel:
        width, height = self.camera_size
        size = width / 1024
        cx, cy = (width - 1) / 2 + offset[0] * size, (height - 1) / 2 + offset[1] * size
        matrix = np.array([[self.focal_px, offset[2] * size, cx], [0, self.focal_px * 1.0003, cy], [0, 0, 1]])
        return CameraModel(self.camera_size, matrix, self.lens * distortion, name=name)

    def _projector(self) -> CameraModel:
        width, height = self.projector_size
        focal = self.projector_focal_px
        matrix = np.array([[focal, 0, (width - 1) / 2 + 4.0 * width / 1280], [0, focal, (height - 1) / 2], [0, 0, 1]])
        distortion = self.lens * np.array([-0.05, 0.05, 1e-4, -2e-4, 0.0])
        return CameraModel(self.projector_size, matrix, distortion, name="projector")


def _scaled(size: tuple[int, int], factor: float) -> tuple[int, int]:
    return max(8, round(size[0] * factor)), max(8, round(size[1] * factor))


def _aimed(device: CameraModel, centre: Array, target: Array) -> CameraModel:
    """The device at ``centre`` with its axis through ``target`` and its rows along the baseline."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    down = np.array([0.0, 1.0, 0.0]) - forward[1] * forward
    down /= np.linalg.norm(down)
    rotation = np.stack([np.cross(down, forward), down, forward])
    return CameraModel(device.size, device.matrix, device.distortion, rotation, -rotation @ centre, device.name)


def _misplaced(projector: CameraModel, error_px: tuple[float, float]) -> CameraModel:
    """The projector with wrong columns: a shift, and a stretch of ``error_px[1]`` at the image's edges."""
    shift, stretch = error_px
    if shift == 0 and stretch == 0:
        return projector
    matrix = projector.matrix.copy()
    matrix[0, 2] += shift
    matrix[0, 0] *= 1 + 2 * stretch / projector.size[0]
    return CameraModel(
        projector.size, matrix, projector.distortion, projector.rotation, projector.translation, "projector"
    )
