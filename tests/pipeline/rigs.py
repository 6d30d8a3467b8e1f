"""Rigs with every kind of awkwardness in them: distortion, skew, rotations about all axes."""

import numpy as np

from pipeline.rig.calibration import Calibration, ColorModel
from pipeline.rig.camera_model import CameraModel

CROSSTALK = np.array([[1.0, 0.08, 0.02], [0.06, 1.0, 0.09], [0.01, 0.07, 1.0]])


def rotation(x: float, y: float, z: float) -> np.ndarray:
    """Rotation about the three axes, radians."""
    cx, sx, cy, sy, cz, sz = np.cos(x), np.sin(x), np.cos(y), np.sin(y), np.cos(z), np.sin(z)
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return rz @ ry @ rx


def camera(name: str, centre: tuple[float, float, float], turn: tuple[float, float, float], **changes) -> CameraModel:
    """A 256 x 205 camera with distortion and skew whose axis is roughly z."""
    r = rotation(*turn)
    values = {
        "size": (256, 205),
        "matrix": np.array([[850.0, 0.7, 130.0], [0, 848.0, 101.0], [0, 0, 1]]),
        "distortion": np.array([-0.12, 0.3, 0.0008, -0.0005, 0.1]),
        "rotation": r,
        "translation": -r @ np.array(centre),
        "name": name,
    }
    return CameraModel(**(values | changes))


def rig() -> Calibration:
    """Baseline 500 mm, projector at 0.382 of it and 60 mm above, 1.4 m away."""
    return Calibration(
        left=camera("left", (0, 0, 0), (0, 0, 0)),
        right=camera("right", (500, 0, 40), (0.01, -0.345, 0.02)),
        projector=camera(
            "projector", (191, -60, 10), (-0.04, -0.137, -0.01), size=(320, 256),
            matrix=np.array([[1066.0, 0, 160.0], [0, 1066.0, 128.0], [0, 0, 1]]),
            distortion=np.array([-0.05, 0.1, 0.0003, 0.0002, 0.0]),
        ),
        left_color=ColorModel(np.array([2.0, 3.0, 2.5]), CROSSTALK),
        right_color=ColorModel(np.array([1.0, 2.0, 1.5]), CROSSTALK.T),
    )  # fmt: skip


def points(n: int = 500, seed: int = 1) -> np.ndarray:
    """(n, 3) points inside the rig's volume."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(1285, 1515, n)
    return np.stack([rng.uniform(-0.12, 0.12, n) * z, rng.uniform(-0.1, 0.1, n) * z, z], axis=-1)
