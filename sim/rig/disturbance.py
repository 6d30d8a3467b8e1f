"""Disturbances of a rig after its calibration: rotated devices, shifted lenses, drift of colours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.camera_model import CameraModel
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics, crosstalk_shape
from sim.scene.shapes import Triple, rotation_about

Array = NDArray[np.float64]
Device = Literal["left", "right", "projector"]
DEVICES: tuple[Device, ...] = get_args(Device)


@dataclass(frozen=True, slots=True)
class Disturbance:
    """One change of one device.

    Args:
        side: ``left``, ``right`` or ``projector``.
        at: number of the first trigger affected, counted from 0.
        turn_deg: rotation vector in the device's own frame, degrees; it turns about its centre of projection.
        shift_px: shift of the principal point, pixels.
        crosstalk: added to the camera's largest crosstalk; 0.03 is three percent of a channel's light.
    """

    side: Device
    at: int = 0
    turn_deg: Triple = (0.0, 0.0, 0.0)
    shift_px: tuple[float, float] = (0.0, 0.0)
    crosstalk: float = 0.0

    def __post_init__(self) -> None:
        if self.side not in DEVICES:
            raise ValueError(f"disturb.side is {self.side!r}, expected one of {', '.join(DEVICES)}")
        if isinstance(self.at, bool) or not isinstance(self.at, int) or self.at < 0:
            raise ValueError(f"disturb.at is {self.at!r}, expected the number of a trigger, 0 or more")
        if len(self.turn_deg) != 3 or len(self.shift_px) != 2:
            raise ValueError("disturb.turn_deg takes three numbers (x, y, z) and disturb.shift_px two (u, v)")
        numbers = np.array([*self.turn_deg, *self.shift_px, self.crosstalk], dtype=np.float64)
        if not np.isfinite(numbers).all() or np.abs(numbers[:3]).max() > 45:
            raise ValueError(f"disturb.turn_deg {self.turn_deg}: expected finite numbers, and at most 45 degrees")
        if self.side == "projector" and self.crosstalk != 0:
            raise ValueError("disturb.crosstalk is of a camera: the projector has none")


@dataclass(frozen=True, slots=True, eq=False)
class TrueRig:
    """The true devices, not as calibrated; the world is the frame of the left camera before all disturbances.

    Args:
        left, right, projector: with their poses. crosstalk: (2, 3, 3) of both cameras.
    """

    left: CameraModel
    right: CameraModel
    projector: CameraModel
    crosstalk: Array

    @classmethod
    def of(cls, layout: RigLayout, optics: Optics) -> TrueRig:
        """The undisturbed rig."""
        rig = layout.calibration()
        return cls(rig.left, rig.right, rig.projector, optics.true_crosstalk())

    def after(self, change: Disturbance) -> TrueRig:
        """The rig after a disturbance."""
        device: CameraModel = getattr(self, change.side)
        rotation = rotation_about(change.turn_deg, float(np.radians(np.linalg.norm(change.turn_deg)))) @ device.rotation
        matrix = device.matrix.copy()
        matrix[:2, 2] += change.shift_px
        moved = CameraModel(
            device.size, matrix, device.distortion, rotation, -rotation @ device.centre, name=device.name
        )
        if change.side == "left":
            rig = replace(self, left=moved)
        elif change.side == "right":
            rig = replace(self, right=moved)
        else:
            return replace(self, projector=moved)
        camera = ("left", "right").index(change.side)
        crosstalk = self.crosstalk.copy()
        crosstalk[camera] += change.crosstalk * crosstalk_shape(camera)
        return replace(rig, crosstalk=crosstalk)
