"""Views of a board as perfect decoding gives them, computed from the true rig, with optional noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.projector.absolute_phase import Coordinate
from pipeline.calibrate.projector.projector_marks import CameraObservation
from pipeline.calibrate.targets.board import board_drawing
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import Marks
from pipeline.rig.camera_model import CameraModel
from sim.boards.board_scene import BoardPose, true_centroids
from sim.rig.layout import RigLayout

F64 = NDArray[np.float64]


def on_board(device: CameraModel, rotation: F64, place: F64) -> F64:
    """Positions on the board (H, W, 2), mm, of the device's pixels."""
    rays = np.concatenate([device.rays(), np.ones((*device.size[::-1], 1))], axis=-1) @ device.rotation
    origin = (device.centre - place) @ rotation
    local = rays @ rotation
    return (origin - local * (origin[2] / local[..., 2])[..., None])[..., :2]


def whiteness(board: Board, places: F64) -> F64:
    """1 on paper, 0.05 on ink, 0.3 beyond the sheet; edges as sharp as the drawing."""
    sheet = board_drawing.shapes(board)
    x, y = places[..., 0], places[..., 1]
    ink = np.zeros(x.shape, np.bool_)
    for cx, cy, r in sheet.discs:
        ink |= (x - cx) ** 2 + (y - cy) ** 2 <= r * r
    for x0, y0, x1, y1 in sheet.squares:
        ink |= (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
    beyond = (x < -sheet.offset_mm[0]) | (y < -sheet.offset_mm[1])
    beyond |= (x > sheet.width_mm - sheet.offset_mm[0]) | (y > sheet.height_mm - sheet.offset_mm[1])
    return np.where(ink, 0.05, np.where(beyond, 0.3, 1.0))


def observation(
    layout: RigLayout,
    board: Board,
    pose: BoardPose,
    side: str,
    *,
    phase_px: float = 0.0,
    mark_px: float = 0.0,
    seed: int = 0,
) -> CameraObservation:
    """A camera's observation of a view, with noise of the projector coordinates on white and of the marks, pixels."""
    rig = layout.calibration()
    device = {"left": rig.left, "right": rig.right}[side]
    rng = np.random.default_rng([seed, len(side)])
    rotation, place = pose.in_world(board, layout)
    places = on_board(device, rotation, place)
    white = whiteness(board, places)
    world = np.concatenate([places, np.zeros((*places.shape[:2], 1))], axis=-1) @ rotation.T + place
    light = rig.projector.project(world)
    sigma = max(phase_px, 1e-6) / np.sqrt(white)
    coordinates = []
    for c in range(2):
        px = light[..., c] + (phase_px > 0) * sigma * rng.standard_normal(sigma.shape)
        px[(light[..., c] < -0.5) | (light[..., c] > layout.projector_size[c] - 0.5) | (white < 0.1)] = np.nan
        coordinates.append(Coordinate(px, sigma, 90 * white, 100 * white, np.zeros(white.shape, np.bool_)))
    ids = np.arange(len(board.points))
    if board.round:
        pixels, areas = true_centroids(device, board, rotation, place)
    else:
        pixels, areas = device.project(board.points @ rotation.T + place), None
    pixels = pixels + mark_px * rng.standard_normal(pixels.shape)
    return CameraObservation(Marks(ids, pixels, np.full(len(ids), max(mark_px, 1e-6)), areas), *coordinates)
