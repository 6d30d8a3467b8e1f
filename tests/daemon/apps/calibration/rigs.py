"""Calibrated rigs for the tests of files."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.rig.calibration import Calibration, Cameras, ColorModel, Response
from pipeline.rig.camera_model import CameraModel


def cameras(seed: int = 0, *, skew: bool = False, k3: bool = True, vertical: bool = False) -> Cameras:
    rng = np.random.default_rng(seed)

    def device(name: str, size: tuple[int, int], turn: np.ndarray, move: np.ndarray) -> CameraModel:
        fx, fy = rng.uniform(1.5, 4) * rng.uniform(0.9, 1.1, 2) * size[0] / 1.5
        cx, cy = (np.array(size) - 1) / 2 + rng.uniform(-20, 20, 2)
        matrix = np.array([[fx, rng.uniform(-2, 2) if skew else 0.0, cx], [0, fy, cy], [0, 0, 1]])
        distortion = rng.uniform(-1, 1, 5) * (0.1, 0.2, 1e-3, 1e-3, 0.3 if k3 else 0.0)
        return CameraModel(size, matrix, distortion, np.asarray(cv2.Rodrigues(turn)[0]), move, name)

    move = np.array([-500.0, 8.0, 60.0]) if not vertical else np.array([5.0, -400.0, 30.0])
    turn = rng.uniform(-0.1, 0.1, 3) + ((0, 0.3, 0) if not vertical else (-0.3, 0, 0))
    left = device("left", (1024, 820), np.zeros(3), np.zeros(3))
    return Cameras(left, device("right", (1024, 820), turn, move))


def complete(seed: int = 0) -> Calibration:
    pair = cameras(seed)
    projector = CameraModel(
        (1280, 1024),
        np.array([[2200.0, 0, 640], [0, 2200, 700], [0, 0, 1]]),
        rotation=np.asarray(cv2.Rodrigues(np.array([0.02, 0.12, 0.0]))[0]),
        translation=np.array([-190.0, 60, 10]),
        name="projector",
    )
    levels = np.linspace(0, 255, 17)
    crosstalk = np.array([[1, 0.1, 0], [0.08, 1, 0.1], [0, 0.12, 1]])
    return Calibration(
        pair.left,
        pair.right,
        projector,
        ColorModel(np.array([2.0, 3, 4]), crosstalk),
        ColorModel(np.array([1.0, 2, 3]), crosstalk.T),
        Response(levels, np.tile((levels / 255) ** 2.2, (3, 1))),
    )
