"""Images of printed boards in cameras and a projector of a known rig: exact geometry, without the renderer.

Every pixel is the mean of four rays to the board's plane, blurred a little more, with noise. Distances in mm.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.board.board_drawing import raster
from pipeline.pattern.projected_frames import Uniform
from pipeline.pattern.sequence import FrameSequence
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel

SIZE = (400, 320)
PROJECTOR = (480, 384)
SUB = 2
STEP_MM = 0.5
WHITE, DARK = 190.0, 12.0


def rig(size: tuple[int, int] = SIZE) -> Cameras:
    """Two cameras 400 mm apart, aimed at a point 1 m away, and a projector between them."""
    f = 2.3 * size[0]

    def device(name: str, at: float, size: tuple[int, int], f: float, k: float) -> CameraModel:
        turn = np.asarray(cv2.Rodrigues(np.array([0.0, np.arctan2(at, 1000.0), 0.0]))[0])
        matrix = np.array([[f, 0, size[0] / 2 + 3], [0, 1.002 * f, size[1] / 2 - 4], [0, 0, 1]])
        centre = np.array([at, -8.0 * (at != 0), 5.0 * (at != 0)])
        return CameraModel(size, matrix, np.array([k, 0.1, 5e-4, -3e-4, 0]), turn, -turn @ centre, name)

    return Cameras(
        device("left", 0.0, size, f, -0.12),
        device("right", 400.0, size, 1.01 * f, -0.1),
        projector=device("projector", 0.382 * 400.0, PROJECTOR, 2.0 * PROJECTOR[0], -0.05),
    )


def poses(
    board: Board, count: int = 12, seed: int = 0, *, tilt_deg: float = 35.0
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poses of a good session, board to world: tilted to all sides, moved towards the images' edges."""
    rng = np.random.default_rng(seed)
    middle = (board.points.min(axis=0) + board.points.max(axis=0)) / 2
    out = []
    for k in range(count):
        angle = 2 * np.pi * k / count
        tilt = np.radians(tilt_deg) * (0.35 + 0.65 * (k % 3) / 2)
        vector = np.array([np.cos(angle) * tilt, np.sin(angle) * tilt, rng.uniform(-0.15, 0.15)])
        turn = np.asarray(cv2.Rodrigues(vector)[0])
        position = np.array([170.0, -4, 0]) * 0.12 + [
            45 * np.cos(2.4 * k),
            36 * np.sin(2.4 * k),
            1000 + 25 * (k % 4 - 1.5),
        ]
        out.append((turn, position - turn @ middle))
    return out


def draw(
    device: CameraModel,
    board: Board,
    pose: tuple[np.ndarray, np.ndarray],
    *,
    seed: int,
    light: np.ndarray | None = None,
    projector: CameraModel | None = None,
    noise: float = 0.8,
    blur: float = 0.6,
) -> np.ndarray:
    """One image, (H, W) uint8. With ``light`` (h, w), 0..1, the projector shows that image, else uniform white."""
    albedo, at = _geometry(device, board, pose, projector if light is not None else None)
    shade = albedo
    if light is not None and at is not None:
        shade = albedo * cv2.remap(light.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    counts = DARK + WHITE * cv2.resize(shade, device.size, interpolation=cv2.INTER_AREA)  # the means
    counts = cv2.GaussianBlur(counts, (0, 0), blur)
    noisy = counts + np.random.default_rng(seed).normal(0, noise, counts.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


_CACHE: dict[tuple[object, ...], tuple[np.ndarray, np.ndarray | None]] = {}


def _geometry(
    device: CameraModel, board: Board, pose: tuple[np.ndarray, np.ndarray], projector: CameraModel | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Albedo and projector pixel of every ray, (SUB H, SUB W, ...); the last one is cached."""
    key = (id(device), id(projector), str(board), pose[0].tobytes() + pose[1].tobytes())
    if key not in _CACHE:
        _CACHE.clear()
        rays = _rays(device)
        turn, position = pose
        normal = turn[:, 2]
        depth = ((position - device.centre) @ normal) / (rays @ normal)
        world = device.centre + depth[..., None] * rays
        plane = (world - position) @ turn
        sheet, origin = _sheet(board)
        at = ((plane[..., :2] - origin) / STEP_MM).astype(np.float32)
        albedo = cv2.remap(sheet, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0.25)
        lit = None
        if projector is not None:
            lit = projector.project(world.reshape(-1, 3)).reshape(*world.shape[:2], 2).astype(np.float32)
        _CACHE[key] = albedo, lit
    return _CACHE[key]


@lru_cache(maxsize=4)
def _rays(device: CameraModel) -> np.ndarray:
    """Directions (SUB H, SUB W, 3) in the world, z = 1 in the device; the same for every pose."""
    width, height = device.size
    # The distortion is removed at the pixels' corners; inside a pixel a straight line differs by less than 1e-4
    # pixels.
    corners = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
    coarse = device.normalise(np.stack(corners, axis=-1))
    share = (np.arange(SUB) + 0.5) / SUB
    rows = coarse[:-1, None] + share[:, None, None] * (coarse[1:, None] - coarse[:-1, None])
    rows = rows.reshape(height * SUB, width + 1, 2)
    ideal = rows[:, :-1, None] + share[:, None] * (rows[:, 1:, None] - rows[:, :-1, None])
    ideal = ideal.reshape(height * SUB, width * SUB, 2)
    return np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=-1) @ device.rotation


@lru_cache(maxsize=4)
def _sheet(board: Board) -> tuple[np.ndarray, tuple[float, float]]:
    return raster(board, STEP_MM)


def write_pairs(
    folder: Path, cameras: Cameras, board: Board, board_poses: Sequence[tuple[np.ndarray, np.ndarray]], *, seed: int = 0
) -> None:
    """``L/00.png`` ... and ``R/00.png`` ..."""
    for side, device in (("L", cameras.left), ("R", cameras.right)):
        (folder / side).mkdir(parents=True, exist_ok=True)
        for k, pose in enumerate(board_poses):
            image = draw(device, board, pose, seed=1000 * seed + 2 * k + (side == "R"))
            write_png(folder / side / f"{k:02d}.png", image)


def write_capture(
    folder: Path,
    cameras: Cameras,
    board: Board,
    board_poses: Sequence[tuple[np.ndarray, np.ndarray]],
    sequence: FrameSequence,
    *,
    seed: int = 0,
) -> None:
    """A capture folder, ``mono8``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.json").write_text(json.dumps({"encoding": "mono8", "sequence": sequence.as_mapping()}))
    for k, pose in enumerate(board_poses):
        view = folder / f"view_{k:02d}"
        view.mkdir(exist_ok=True)
        for side, device in (("left", cameras.left), ("right", cameras.right)):
            for n, frame in enumerate(sequence.frames):
                light = frame.image()[..., 1] / 255.0 if isinstance(frame, Uniform) else frame.light()[..., 1] / 255.0
                image = draw(
                    device, board, pose, seed=100_000 * seed + 1000 * k + 2 * n + (side == "right"), light=light,
                    projector=cameras.projector,
                )  # fmt: skip
                write_png(view / f"{side}_{n:02d}.png", image)


def write_png(path: Path, image: np.ndarray) -> None:
    """Uncompressed, which takes the least time."""
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image, [cv2.IMWRITE_PNG_COMPRESSION, 0])
