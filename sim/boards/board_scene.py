"""Printed calibration boards on the stage, their images, and the true pixels of their marks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board import board_drawing
from pipeline.calibrate.targets.board.board import Board
from pipeline.pattern.sequence import FrameSequence, camera_sequence
from pipeline.rig.camera_model import CameraModel
from sim.boards.board_poses import BoardPose, middle, session_poses
from sim.render.projection_transport import Counts, Stage
from sim.render.render_pair import Image, with_noise
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.printed_marks import Ink
from sim.scene.scene import Scene
from sim.scene.shapes import Shape, Triple, rectangle

__all__ = [
    "BoardPose",
    "RenderedViews",
    "board_scene",
    "board_shape",
    "render_views",
    "session_poses",
    "true_centroids",
    "true_marks",
]

Array = NDArray[np.float64]
PAPER_ALBEDO, INK_ALBEDO = 0.9, 0.05
SUPERSAMPLING = 4
_OUTLINE_POINTS = 360


def board_shape(board: Board, *, at_mm: Triple = (0.0, 0.0, 0.0), turn: Triple = (0.0, 0.0, 0.0)) -> Shape:
    """A board on the stage: matte white paper with black marks on its front.

    Args:
        board: what is printed.
        at_mm: position of the centre of its marks on the stage; turn: rotation vector, radians.
    """
    sheet = board_drawing.shapes(board)
    x, y = sheet.width_mm / 2 - sheet.offset_mm[0], sheet.height_mm / 2 - sheet.offset_mm[1]
    centre = np.array([x, y, 0.0])
    ink = Ink(sheet.discs - centre, sheet.squares - [x, y, x, y], INK_ALBEDO / PAPER_ALBEDO)
    pose = BoardPose(at_mm, turn)
    a, b, c = np.array(at_mm) + pose.rotation @ (centre - middle(board))
    paper = rectangle(sheet.width_mm, sheet.height_mm, ink=ink)
    return paper.placed((float(a), float(b), float(c)), turn=turn, albedo=PAPER_ALBEDO)


def board_scene(board: Board, pose: BoardPose | None = None, *, beside: Sequence[Shape] = ()) -> Scene:
    """A scene at rest: a board, and other shapes ``beside`` it, such as an occluder or a second board."""
    pose = pose or BoardPose()
    return Scene("board", (board_shape(board, at_mm=pose.at_mm, turn=pose.turn), *beside))


@dataclass(frozen=True, slots=True, eq=False)
class RenderedViews:
    """Views of a board without noise; many sessions with different noise come from one rendering.

    Args:
        layout, board, optics, encoding, poses: what was rendered.
        counts: for each pose and projected frame, left and right counts above black.
    """

    layout: RigLayout
    board: Board
    optics: Optics
    encoding: str
    poses: tuple[BoardPose, ...]
    counts: tuple[tuple[Counts, ...], ...]

    def images(self, seed: int, view: int) -> list[tuple[Image, Image]]:
        """Left and right image of each frame of a view; the seed determines the noise."""
        frames = self.counts[view]
        start = 1_000_003 * seed + 1009 * view
        return [with_noise(pair, self.optics, start + k, self.encoding) for k, pair in enumerate(frames)]


def render_views(
    layout: RigLayout,
    board: Board,
    poses: Sequence[BoardPose],
    optics: Optics | None = None,
    frames: FrameSequence | Sequence[NDArray[np.uint8]] | None = None,
    *,
    encoding: str = "rgb8",
    beside: Sequence[Shape] = (),
) -> RenderedViews:
    """Render a board at each pose under each projected frame.

    Args:
        layout: the rig. board: on its stage. poses: see :func:`session_poses`.
        optics: light, lenses and sensor; with 4 x 4 rays a pixel at least. The standard ones if None.
        frames: that the projector shows: a sequence (sent uncorrected, the response being unknown) or images,
            (H, W, 3) uint8; if None, white without saturation.
        encoding: of the cameras.
        beside: other shapes on the stage.
    """
    optics = fine(optics or Optics())
    frames = camera_sequence(layout.projector_size) if frames is None else frames
    images = [frame.image() for frame in frames.frames] if isinstance(frames, FrameSequence) else list(frames)
    counts = []
    for pose in poses:
        stage = Stage(layout, board_scene(board, pose, beside=beside), optics, encoding=encoding)
        counts.append(tuple(stage.counts(image) for image in images))
    return RenderedViews(layout, board, optics, encoding, tuple(poses), tuple(counts))


def fine(optics: Optics) -> Optics:
    """The optics with as many rays a pixel as a board's edges require."""
    return replace(optics, supersampling=max(SUPERSAMPLING, optics.supersampling))


def true_marks(layout: RigLayout, board: Board, pose: BoardPose) -> dict[str, Array]:
    """Pixels (n, 2) of the marks' points in ``left``, ``right`` and ``projector``, inside the image or not."""
    rotation, place = pose.in_world(board, layout)
    world = board.points @ rotation.T + place
    rig = layout.calibration()
    return {device.name: device.project(world) for device in (rig.left, rig.right, rig.projector)}


def true_centroids(device: CameraModel, board: Board, rotation: Array, place: Array) -> tuple[Array, Array]:
    """Centroids (n, 2) and areas (n,) of the images of a board's circles, by Green's theorem along their outlines.

    Args:
        device: camera or projector. rotation, place: board to world.
    """
    angle = 2 * np.pi * np.arange(_OUTLINE_POINTS) / _OUTLINE_POINTS
    circle = board.printed_diameter_mm / 2 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    outline = device.project((board.points[:, None] + circle) @ rotation.T + place)
    centre = outline.mean(axis=1, keepdims=True)
    u, v = np.moveaxis(outline - centre, -1, 0)
    # The outline is a smooth closed curve of the angle: sums over equal steps are exact to rounding, and so are
    # derivatives by the discrete Fourier transform.
    du, dv = _derivative(u), _derivative(v)
    step = 2 * np.pi / _OUTLINE_POINTS
    area = 0.5 * step * (u * dv - v * du).sum(axis=1)
    x = 0.5 * step * (u * u * dv).sum(axis=1) / area
    y = -0.5 * step * (v * v * du).sum(axis=1) / area
    return centre[:, 0] + np.stack([x, y], axis=1), np.abs(area)


def _derivative(values: Array) -> Array:
    spectrum = np.fft.rfft(values, axis=-1)
    return np.asarray(np.fft.irfft(1j * np.arange(spectrum.shape[-1]) * spectrum, n=values.shape[-1], axis=-1))
