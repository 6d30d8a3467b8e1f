"""Poses of a board in a session: near and far, tilted, and moved so that its marks reach the images' corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board
from pipeline.rig.camera_model import CameraModel
from sim.rig.layout import RigLayout
from sim.scene.shapes import Triple, rotation_about

Array = NDArray[np.float64]

MOST_TILT_DEG = 45.0
# Least distance of the marks from the border of each device's image, as a fraction of its width, and the reach of the
# poses beyond the measuring volume, as a fraction of its half depth.
_MARGIN, _BEYOND = 0.01, 1.2
# Of a hundredth of the stand-off each: further away the cameras' fields overlap less.
_STEPS = 30
_CORNERS = np.array([(-1, -1), (1, 1), (1, -1), (-1, 1), (0, -1), (0, 1), (-1, 0), (1, 0)], float)


@dataclass(frozen=True, slots=True)
class BoardPose:
    """Pose of a board on the stage: position of the centre of its marks, mm, and rotation vector, radians."""

    at_mm: Triple = (0.0, 0.0, 0.0)
    turn: Triple = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> Array:
        """Board to stage, (3, 3)."""
        return rotation_about(self.turn, float(np.linalg.norm(self.turn)))

    @property
    def tilt_deg(self) -> float:
        """Angle between the board's normal and the stage's z axis."""
        return float(np.degrees(np.arccos(np.clip(self.rotation[2, 2], -1.0, 1.0))))

    def in_world(self, board: Board, layout: RigLayout) -> tuple[Array, Array]:
        """(R, t) with ``X_world = R X_board + t``, the board's origin at mark 0."""
        rotation, origin = layout.stage_pose()
        turn = rotation @ self.rotation
        return turn, rotation @ np.array(self.at_mm) + origin - turn @ middle(board)


def middle(board: Board) -> Array:
    """Middle of the marks in the board's frame, (3,), mm."""
    points = board.points
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def session_poses(
    n: int = 12,
    seed: int = 0,
    layout: RigLayout | None = None,
    board: Board = DEFAULT_BOARD,
    *,
    tilt_deg: float = MOST_TILT_DEG,
) -> list[BoardPose]:
    """Poses of a good session, each with all marks in both cameras and in the projector's image.

    The first faces the rig; the others tilt by up to ``tilt_deg`` about axes all around, at distances within and
    slightly beyond the measuring volume, each as far towards a corner or an edge of the images as its marks allow.

    Args:
        n: number of poses, 1 or more.
        seed: varies the poses about the same plan.
        layout: the rig, the standard one if None.
        board: that must fit into the images.
        tilt_deg: largest tilt, up to 60.
    """
    if n < 1 or not 0 <= tilt_deg <= 60:
        raise ValueError(f"session_poses: n is {n}, tilt_deg {tilt_deg}; expected 1 or more, and 0 to 60")
    layout = layout or RigLayout()
    return [_pose(k, seed, layout, board, tilt_deg) for k in range(n)]


def _pose(k: int, seed: int, layout: RigLayout, board: Board, tilt_deg: float) -> BoardPose:
    rng = np.random.default_rng([seed, k, 5])
    # Successive tilt axes differ by the golden angle, so that any number of poses covers all directions.
    axis = 2 * np.pi * 0.381966 * k + rng.uniform(-0.2, 0.2)
    tilt = 0.0 if k == 0 else np.radians(tilt_deg) * (1.0, 0.75, 0.5)[k % 3] * rng.uniform(0.93, 1.0)
    roll = rng.uniform(-0.12, 0.12) + (0.0, 0.15, -0.15)[k % 3]
    half = _BEYOND * layout.depth_mm / 2
    depth = half * ((2 * ((k * 0.618034 + 0.5) % 1.0) - 1) + rng.uniform(-0.1, 0.1))
    tilted = rotation_about((np.cos(axis), np.sin(axis), 0.0), tilt)
    for share in (1.0, 0.6, 0.3, 0.0):
        # A large board is rolled less, or no image holds all of it.
        turn = tilted @ rotation_about((0.0, 0.0, 1.0), share * roll)
        position = _nearest_fit(depth, turn, layout, board)
        if position is not None:
            break
    else:
        raise ValueError(f"session_poses: the board {board} does not fit into the images at any distance")
    # The reach varies as with a hand-held board; the first pose stays in the middle.
    reach = 0.0 if k == 0 else rng.uniform(0.9, 1.0)
    corner = _CORNERS[k % len(_CORNERS)]
    for along in (0, 1) if k % 2 else (1, 0):
        position = position + reach * _furthest(position, np.eye(3)[along] * corner[along], turn, layout, board)
    x, y, z = (float(value) for value in position)
    return BoardPose((x, y, z), _rotation_vector(turn))


def _nearest_fit(depth: float, turn: Array, layout: RigLayout, board: Board) -> Array | None:
    """The position in the middle of all images where the board fits, at a depth or a little further away."""
    rig = layout.calibration()
    corners = _corners(turn, layout, board)
    rotation, origin = layout.stage_pose()
    for step in range(_STEPS):
        position = np.array([0.0, 0.0, depth + 0.01 * step * layout.standoff_mm])
        for _ in range(4):
            offset = np.zeros(2)
            for device in (rig.left, rig.right, rig.projector):
                pixels = device.project(corners + rotation @ position + origin)
                off = (np.array(device.size) - 1) / 2 - (pixels.min(axis=0) + pixels.max(axis=0)) / 2
                offset += off * (layout.standoff_mm + position[2]) / device.matrix[0, 0] / 3
            position[:2] += np.nan_to_num(offset)
        if _fits(position, corners, layout):
            return position
    return None


def _furthest(position: Array, direction: Array, turn: Array, layout: RigLayout, board: Board) -> Array:
    """The longest shift from a position along a direction with all marks in all images, (3,), mm."""
    corners = _corners(turn, layout, board)
    inner, outer = 0.0, layout.standoff_mm / 4
    for _ in range(14):
        way = (inner + outer) / 2
        inner, outer = (way, outer) if _fits(position + way * direction, corners, layout) else (inner, way)
    return inner * direction


def _corners(turn: Array, layout: RigLayout, board: Board) -> Array:
    """Corners of all marks, (4, 3), relative to their middle, along the world's axes."""
    x, y, _ = (board.points - middle(board)).T
    grow = board.printed_diameter_mm / 2 if board.round else board.pitch_mm
    corners = np.array([[sx * (x.max() + grow), sy * (y.max() + grow), 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    return np.asarray(corners @ turn.T @ layout.stage_pose()[0].T)


def _fits(position: Array, corners: Array, layout: RigLayout) -> bool:
    rig = layout.calibration()
    rotation, origin = layout.stage_pose()
    world = corners + rotation @ position + origin
    return all(_contains(device, world) for device in (rig.left, rig.right, rig.projector))


def _contains(device: CameraModel, world: Array) -> bool:
    pixels = device.project(world)
    size, margin = np.array(device.size), _MARGIN * device.size[0]
    with np.errstate(invalid="ignore"):
        return bool(((pixels >= margin) & (pixels <= size - 1 - margin)).all())


def _rotation_vector(rotation: Array) -> Triple:
    """Rotation vector of a rotation by less than half a turn."""
    angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0))
    offset = np.array([
        rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]
    ])  # fmt: skip
    scale = 0.5 if angle < 1e-9 else angle / (2 * np.sin(angle))
    x, y, z = scale * offset
    return float(x), float(y), float(z)
