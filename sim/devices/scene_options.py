"""The scene of the options: a named one, or a board at a pose of its session."""

from __future__ import annotations

from functools import lru_cache

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board, parse_board
from sim.boards.board_poses import BoardPose, session_poses
from sim.boards.board_scene import board_scene, fine
from sim.devices.options import BOARD_SCENE, SimOptions
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene import named_scenes
from sim.scene.scene import Scene


def scene_of(options: SimOptions, pose: int = 0) -> Scene:
    """The scene, for the scene ``board`` at pose number ``pose`` (the last one for larger numbers)."""
    if options.scene == BOARD_SCENE:
        poses = poses_of(options)
        return board_scene(board_of(options), poses[min(pose, len(poses) - 1)])
    return named_scenes.build(options.scene, seed=options.seed, mesh_file=options.mesh)


def optics_of(options: SimOptions) -> Optics:
    """The optics, with as many rays a pixel as the scene requires."""
    return fine(options.optics) if options.scene == BOARD_SCENE else options.optics


def board_of(options: SimOptions) -> Board:
    """The board of the scene ``board``."""
    return parse_board(options.board) if options.board else DEFAULT_BOARD


def poses_of(options: SimOptions) -> tuple[BoardPose, ...]:
    """Successive poses of the board."""
    return _poses(options.poses, options.seed, options.layout, board_of(options))


@lru_cache(maxsize=8)
def _poses(n: int, seed: int, layout: RigLayout, board: Board) -> tuple[BoardPose, ...]:
    return tuple(session_poses(n, seed, layout, board))
