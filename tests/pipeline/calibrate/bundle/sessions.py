"""Synthetic sessions with known truth: marks without images."""

from __future__ import annotations

import numpy as np

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.rig.camera_model import CameraModel
from sim.rig.layout import RigLayout


def rotation(x: float, y: float, z: float) -> np.ndarray:
    """Rotations about x, then y, then z, degrees."""
    a, b, c = np.radians([x, y, z])
    rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return rz @ ry @ rx


def poses(n: int, seed: int, board: Board, layout: RigLayout, *, tilt: float = 40.0) -> list[tuple]:
    """Board to world, (R, t) each: tilts all around up to ``tilt`` degrees, over the field and 200 mm of depth."""
    rng = np.random.default_rng(seed)
    stage_r, stage_t = layout.stage_pose()
    middle = board.points.mean(axis=0)
    result = []
    for k in range(n):
        size = tilt * (0.5 + 0.5 * rng.random())
        around = 2 * np.pi * (k + 0.3 * rng.random()) / n * 5
        turn = rotation(size * np.cos(around), size * np.sin(around), rng.uniform(-12, 12))
        place = np.array([rng.uniform(-45, 45), rng.uniform(-35, 35), rng.uniform(-100, 100)])
        r = stage_r @ turn
        result.append((r, stage_r @ place + stage_t - r @ middle))
    return result


def session(
    board: Board = DEFAULT_BOARD,
    *,
    n: int = 12,
    seed: int = 0,
    sigma: float = 0.0,
    expected_sigma: float | None = None,
    layout: RigLayout | None = None,
    devices: tuple[str, ...] = ("left", "right", "projector"),
    tilt: float = 40.0,
    pose_seed: int = 0,
    margin: float = 0.0,
    points: np.ndarray | None = None,
    board_poses: list[tuple] | None = None,
) -> tuple[list[BoardView], dict[str, tuple[int, int]], dict[str, CameraModel]]:
    """Views, sizes and the true devices; marks outside an image are missing."""
    layout = layout or RigLayout()
    truth = layout.calibration()
    models = {name: getattr(truth, name) for name in devices}
    rng = np.random.default_rng(seed)
    where = board.points if points is None else points
    views = []
    for k, (r, t) in enumerate(board_poses or poses(n, pose_seed, board, layout, tilt=tilt)):
        marks = {}
        for name, model in models.items():
            pixels = model.project(where @ r.T + t)
            inside = ((pixels > margin) & (pixels < np.array(model.size) - 1 - margin)).all(axis=1)
            noisy = pixels + sigma * rng.standard_normal(pixels.shape)
            sigmas = (
                np.full(len(where), sigma or 0.02) if expected_sigma is None else np.full(len(where), expected_sigma)
            )
            marks[name] = Marks(np.arange(len(where)), noisy, sigmas).some(inside)
        views.append(BoardView(f"view_{k:02d}", marks))
    return views, {name: model.size for name, model in models.items()}, models
